#include "odmc/sim/simulator.h"

#include <algorithm>
#include <cmath>
#include <deque>
#include <optional>
#include <stdexcept>
#include <utility>

#include "odmc/math/gaussian.h"
#include "odmc/sim/disturbance.h"
#include "odmc/sim/hanging_load.h"
#include "odmc/sim/motor_drive.h"
#include "odmc/sim/random_streams.h"
#include "odmc/sim/sensors.h"
#include "odmc/sim/tracking_controller.h"
#include "odmc/text/refusal.h"
#include "odmc/trajectory/flatness.h"
#include "odmc/trajectory/trajectory.h"

namespace odmc {
namespace {

constexpr double kControlPeriod_s = 0.0025;    // longest
constexpr double kLostDistance_m = 5.0;        // from the reference: the pilot has lost it
constexpr double kSpoolThrustOverHover = 0.9;  // on the ground, at the end of spooling up

// Whole pieces of at most `longest` that make up `whole`.
int PiecesOf(double whole, double longest) {
  return std::max(1, static_cast<int>(std::ceil(whole / longest - 1e-6)));
}

double BatteryVoltage(const SimulationNoise& noise, double time_s) {
  return std::max(0.0, noise.battery_start_V + noise.battery_slope_V_s * time_s);
}

MotorLag MotorsOf(const Vehicle& vehicle) {
  return vehicle.actuator ? MotorLag::Of(*vehicle.actuator, vehicle.num_rotors()) : MotorLag();
}

// The vehicle, its pilot and the world, advanced in control periods.
class ClosedLoop {
 public:
  ClosedLoop(const RigidBody& body, const ModelValues& values, const SimulationOptions& options,
             const SimulationNoise& noise, const Unmodelled& unmodelled)
      : body_(body),
        variation_(body.model(), values, options.seed),
        load_(body.model(), values),
        unmodelled_(unmodelled),
        pilot_(body, options.pilot_bandwidth),
        trajectory_(options.trajectory, options.ground_s),
        ground_s_(options.ground_s),
        noise_(noise),
        disturbance_(body.model().vehicle(), noise.force_N, noise.torque_Nm, options.seed),
        feedback_(options.seed, kFeedbackStream),
        on_ground_(options.ground_s > 0.0) {
    const FlatReference start = trajectory_.At(0.0);
    state_.p_WB = start.p_WB;
    state_.q_WB = FlatAttitudeOf(start, body.properties().g_W).q_WB;
    state_.rotor_speed = pilot_.HoverSpeeds();
    if (on_ground_) state_.rotor_speed.setZero();
    command_ = state_.rotor_speed;
    const Vehicle& vehicle = body.model().vehicle();
    if (!vehicle.actuator) return;
    drive_.emplace(*vehicle.actuator, vehicle.num_rotors());
    drive_->Start(drive_->ThrottleFor(command_, BatteryVoltage(noise, 0.0)));
  }

  // Chooses what the rotors are told from `time_s` on, and lets go of the ground.
  void Control(double time_s) {
    RigidBodyState seen = state_;
    seen.w_WB_B += noise_.feedback_rate_rad_s * feedback_.Next3();
    if (time_s < ground_s_) {
      Tell(time_s, std::sqrt(kSpoolThrustOverHover) * time_s / ground_s_ * pilot_.HoverSpeeds());
      return;
    }
    const FlatReference reference = trajectory_.At(time_s);
    CheckFollows(time_s, reference);
    Tell(time_s, pilot_.Command(time_s, seen, reference));
    if (on_ground_) on_ground_ = !LiftsOff(time_s);
  }

  void Step(double time_s, double step_s) {
    if (on_ground_) {
      Drive(time_s, step_s, [&](double, const RotorVector& speed_cmd, double piece_s) {
        state_.rotor_speed = body_.motor().After(state_.rotor_speed, speed_cmd, piece_s);
      });
      return;
    }
    variation_.Apply(time_s, &body_);
    const BodyWrench external = ExternalAt(time_s);
    load_.Swing(body_, time_s, command_, external, step_s, &state_);
    Drive(time_s, step_s, [&](double at_s, const RotorVector& speed_cmd, double piece_s) {
      state_ = body_.Step(at_s, state_, speed_cmd, external, piece_s);
    });
  }

  TruthSample Sample(Stamp stamp) {
    const double time_s = ToSeconds(stamp);
    const BodyWrench external = on_ground_ ? GroundReaction(time_s) : ExternalAt(time_s);
    TruthSample sample = TruthOf(body_, stamp, state_, command_, external);
    sample.on_ground = on_ground_;
    return sample;
  }

  // What the ESCs were told; empty for a vehicle without an actuator.
  std::vector<CommandSample> TakeCommands() { return std::move(commands_); }

 private:
  // Speeds to hold from `time_s` on; where there is an actuator, the throttles that hold them.
  void Tell(double time_s, const RotorVector& speed_cmd) {
    command_ = speed_cmd;
    if (!drive_) return;
    const double voltage = BatteryVoltage(noise_, time_s);
    drive_->Command(time_s, drive_->ThrottleFor(speed_cmd, voltage));
    command_ = drive_->SteadySpeeds(voltage);
    commands_.push_back({FromSeconds(time_s), drive_->throttle()});
  }

  // Calls `move` with the speeds the motors are driven to, piece by piece.
  template <typename Move>
  void Drive(double time_s, double step_s, const Move& move) {
    if (!drive_) {
      move(time_s, command_, step_s);
      return;
    }
    const double voltage = BatteryVoltage(noise_, time_s);
    drive_->Advance(time_s, step_s, voltage, move);
    command_ = drive_->SteadySpeeds(voltage);
  }

  // White noise, and what nobody's model knows.
  BodyWrench ExternalAt(double time_s) {
    const BodyWrench& wrench = disturbance_.At(time_s);
    if (!unmodelled_) return wrench;
    return wrench + unmodelled_(body_.FlightStateOf(time_s, state_, command_));
  }

  // What the ground does to a vehicle that rests on it: it bears what thrust does not.
  BodyWrench GroundReaction(double time_s) const {
    const BodyWrench model = body_.WrenchOf(body_.FlightStateOf(time_s, state_, command_));
    const BodyProperties& properties = body_.properties();
    const Eigen::Vector3d g_B = state_.q_WB.conjugate() * properties.g_W;
    return {-properties.mass * g_B - model.f_B, -model.tau_Bcm_B};
  }

  bool LiftsOff(double time_s) const {
    const Eigen::Vector3d ground_W = state_.q_WB * GroundReaction(time_s).f_B;
    return ground_W.z() < 0.0;
  }

  void CheckFollows(double time_s, const FlatReference& reference) const {
    const double distance = (state_.p_WB - reference.p_WB).norm();
    if (distance < kLostDistance_m) return;  // false for NaN, too
    throw std::runtime_error("the vehicle can't follow the trajectory '" + trajectory_.name() +
                             "' with these parameters: lost after " + std::to_string(time_s) +
                             " s of simulated flight");
  }

  RigidBody body_;
  Variation variation_;
  HangingLoad load_;
  const Unmodelled& unmodelled_;
  TrackingController pilot_;
  Trajectory trajectory_;
  double ground_s_;
  SimulationNoise noise_;
  Disturbance disturbance_;
  Gaussian feedback_;
  bool on_ground_;
  RigidBodyState state_;
  std::optional<MotorDrive> drive_;
  RotorVector command_;  // speeds the motors are driven to
  std::vector<CommandSample> commands_;
};

// Everything that sensors see of the truth, each with noise of its own.
class Recorder {
 public:
  Recorder(const BodyProperties& properties, const SimulationOptions& options,
           const SimulationNoise& noise, double period_s)
      : properties_(properties),
        noise_(noise),
        odometry_size_{noise.position_m, noise.attitude_rad, noise.velocity_m_s, noise.rate_rad_s},
        imu_size_{noise.gyro_noise_density * std::sqrt(options.log_rate_hz),
                  noise.accelerometer_noise_density * std::sqrt(options.log_rate_hz),
                  noise.gyro_bias, noise.accelerometer_bias},
        samples_late_(noise.rotor_delay_s / period_s),
        odometry_(options.seed, kOdometryStream),
        rotors_(options.seed, kRotorStream),
        imu_(options.seed, kImuStream) {}

  void Record(const TruthSample& truth, FlightLog* log) {
    OdometrySample odometry = OdometryOf(truth, properties_);
    AddNoise(odometry_size_, &odometry_, &odometry);
    log->odometry.push_back(odometry);
    RotorVector speed = LateSpeed(truth.rotor_speed);
    AddNoise(noise_.rotor_speed_rad_s, &rotors_, &speed);
    log->rotors.push_back({truth.stamp, speed});
    log->battery.push_back({truth.stamp, BatteryVoltage(noise_, ToSeconds(truth.stamp))});
    if (!noise_.imu) return;
    ImuSample imu = ImuOf(truth, properties_);
    AddNoise(imu_size_, &imu_, &imu);
    log->imu.push_back(imu);
  }

 private:
  // True speeds of `rotor_delay_s` before, between samples on a straight line.
  RotorVector LateSpeed(const RotorVector& now) {
    speeds_.push_back(now);
    const double at = std::max(0.0, static_cast<double>(count_) - samples_late_);
    const auto low = static_cast<size_t>(at);
    const double share = at - static_cast<double>(low);
    for (; first_ < low; ++first_) speeds_.pop_front();
    const RotorVector& before = speeds_.front();
    const RotorVector& after = speeds_[std::min<size_t>(1, speeds_.size() - 1)];
    ++count_;
    return (1.0 - share) * before + share * after;
  }

  const BodyProperties& properties_;
  const SimulationNoise& noise_;
  OdometryErrors odometry_size_;
  ImuErrors imu_size_;
  double samples_late_;
  Gaussian odometry_, rotors_, imu_;
  std::deque<RotorVector> speeds_;  // of the samples from `first_` on
  size_t count_ = 0, first_ = 0;
};

void Reserve(size_t samples, bool imu, FlightLog* log) {
  log->odometry.reserve(samples);
  log->rotors.reserve(samples);
  log->battery.reserve(samples);
  if (imu) log->imu.reserve(samples);
}

}  // namespace

bool SimulationOptions::IsValid(std::string* error) const {
  TrajectoryOptions flown;
  flown.name = trajectory;
  if (!flown.IsValid(error)) return false;
  if (!(duration_s > 0.0 && duration_s <= 3600.0)) {
    return Invalid(error, "duration_s must be above 0 and at most 3600 seconds");
  }
  if (!(step_s > 0.0 && step_s <= 0.001)) {
    return Invalid(error, "step_s must be above 0 and at most 0.001 seconds");
  }
  if (!(log_rate_hz >= 1.0 && log_rate_hz <= 1000.0)) {
    return Invalid(error, "log_rate_hz must be 1 to 1000");
  }
  if (!(ground_s >= 0.0 && ground_s < duration_s)) {
    return Invalid(error, "ground_s must be at least 0 and less than duration_s");
  }
  if (!(pilot_bandwidth >= 0.5 && pilot_bandwidth <= 1.5)) {
    return Invalid(error, "pilot_bandwidth must be 0.5 to 1.5");
  }
  return true;
}

SimulationNoise SimulationNoise::None() {
  SimulationNoise none;
  none.position_m = none.attitude_rad = none.velocity_m_s = none.rate_rad_s = 0.0;
  none.rotor_speed_rad_s = none.force_N = none.torque_Nm = none.feedback_rate_rad_s = 0.0;
  return none;
}

bool SimulationNoise::IsValid(std::string* error) const {
  const std::pair<const char*, double> values[] = {
      {"position_m", position_m},
      {"attitude_rad", attitude_rad},
      {"velocity_m_s", velocity_m_s},
      {"rate_rad_s", rate_rad_s},
      {"rotor_speed_rad_s", rotor_speed_rad_s},
      {"force_N", force_N},
      {"torque_Nm", torque_Nm},
      {"feedback_rate_rad_s", feedback_rate_rad_s},
      {"gyro_noise_density", gyro_noise_density},
      {"accelerometer_noise_density", accelerometer_noise_density},
      {"rotor_delay_s", rotor_delay_s},
      {"battery_start_V", battery_start_V},
  };
  for (const auto& [key, value] : values) {
    if (!(value >= 0.0) || !std::isfinite(value)) {
      return Invalid(error, std::string(key) + " must be a number of at least 0");
    }
  }
  if (!gyro_bias.allFinite()) return Invalid(error, "gyro_bias is not finite");
  if (!accelerometer_bias.allFinite()) return Invalid(error, "accelerometer_bias is not finite");
  if (!std::isfinite(battery_slope_V_s)) return Invalid(error, "battery_slope_V_s is not finite");
  return true;
}

FlightLog SimulateLog(const DynamicModel& model, const ModelValues& truth,
                      const SimulationOptions& options, const SimulationNoise& noise,
                      const Unmodelled& unmodelled, const TruthSink& truth_sink) {
  std::string error;
  if (!options.IsValid(&error) || !noise.IsValid(&error)) throw std::invalid_argument(error);
  if (truth.size() != model.num_parameters() || !truth.allFinite()) {
    throw std::invalid_argument("the true values must be one finite number per model parameter");
  }
  const Stamp period = static_cast<Stamp>(std::llround(1e9 / options.log_rate_hz));
  const double period_s = ToSeconds(period);
  const int num_controls = PiecesOf(period_s, kControlPeriod_s);
  const int num_steps = PiecesOf(period_s / num_controls, options.step_s);
  const double step_s = period_s / num_controls / num_steps;
  const long num_samples = std::lround(options.duration_s / period_s) + 1;

  const RigidBody body(model, truth, MotorsOf(model.vehicle()));
  ClosedLoop loop(body, truth, options, noise, unmodelled);
  Recorder recorder(body.properties(), options, noise, period_s);
  FlightLog log;
  log.file = options.trajectory;
  Reserve(static_cast<size_t>(num_samples), noise.imu, &log);
  for (long k = 0; k < num_samples; ++k) {
    const Stamp stamp = k * period;
    for (int i = 0; i < num_controls * num_steps; ++i) {
      const double time_s = ToSeconds(stamp) + i * step_s;
      if (i % num_steps == 0) loop.Control(time_s);
      if (i == 0) {
        const TruthSample sample = loop.Sample(stamp);
        truth_sink(sample);
        recorder.Record(sample, &log);
      }
      loop.Step(time_s, step_s);
    }
  }
  log.commands = loop.TakeCommands();
  return log;
}

SimulatedFlight Simulate(const DynamicModel& model, const ModelValues& truth,
                         const SimulationOptions& options, const SimulationNoise& noise,
                         const Unmodelled& unmodelled) {
  SimulatedFlight flight;
  flight.log = SimulateLog(model, truth, options, noise, unmodelled,
                           [&](const TruthSample& sample) { flight.truth.push_back(sample); });
  return flight;
}

}  // namespace odmc
