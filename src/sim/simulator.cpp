#include "odmc/sim/simulator.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>
#include <variant>

#include "odmc/math/gaussian.h"
#include "odmc/sim/random_streams.h"
#include "odmc/sim/tracking_controller.h"
#include "odmc/sim/world.h"
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
  return std::max(1, static_cast<int>(std::ceil(whole / longest - 1e-9)));
}

// A period of the log, cut into controls and these into steps.
struct Cut {
  explicit Cut(const SimulationOptions& options)
      : period(static_cast<Stamp>(std::llround(1e9 / options.log_rate_hz))),
        controls(PiecesOf(ToSeconds(period), kControlPeriod_s)),
        steps(PiecesOf(ToSeconds(period) / controls, options.step_s)),
        samples(std::lround(options.duration_s / ToSeconds(period)) + 1) {}

  double rate_hz() const { return 1e9 / static_cast<double>(period); }
  double step_s() const { return ToSeconds(period) / controls / steps; }

  Stamp period;
  int controls, steps;  // per period, per control
  long samples;         // of the whole log
};

// Flies a world along a trajectory: spools the rotors up on the ground, then tracks. Knows the true
// model as it is at the start.
class Pilot {
 public:
  Pilot(const DynamicModel& model, const ModelValues& truth, const SimulationOptions& options,
        const SimulationNoise& noise)
      : body_(model, truth),
        controller_(body_, options.pilot_bandwidth),
        trajectory_(options.trajectory, options.ground_s),
        ground_s_(options.ground_s),
        rate_noise_rad_s_(noise.feedback_rate_rad_s),
        feedback_(options.seed, kFeedbackStream) {}

  // Where the flight begins: in hover on the trajectory, or on the ground below it.
  void Start(World* world) const {
    const FlatReference start = trajectory_.At(0.0);
    const RotorVector hover = controller_.HoverSpeeds();
    if (ground_s_ > 0.0) {
      const Eigen::Quaterniond q_WB(Eigen::AngleAxisd(start.yaw, Eigen::Vector3d::UnitZ()));
      world->Put(start.p_WB, q_WB, RotorVector::Zero(hover.size()));
    } else {
      world->Put(start.p_WB, FlatAttitudeOf(start, body_.properties().g_W).q_WB, hover);
    }
  }

  // Tells the rotors what to do from now on.
  void Control(World* world) {
    const double time_s = ToSeconds(world->now());
    RigidBodyState seen = world->state();
    seen.w_WB_B += rate_noise_rad_s_ * feedback_.Next3();
    if (time_s < ground_s_) {
      const double share = std::sqrt(kSpoolThrustOverHover) * time_s / ground_s_;
      world->Command(share * controller_.HoverSpeeds());
      return;
    }
    const FlatReference reference = trajectory_.At(time_s);
    const RotorVector command = controller_.Command(time_s, seen, reference);
    const double distance_m = (seen.p_WB - reference.p_WB).norm();
    if (distance_m < kLostDistance_m && command.allFinite()) {  // false for NaN, too
      world->Command(command);
      return;
    }
    throw std::runtime_error("the vehicle can't follow the trajectory '" + trajectory_.name() +
                             "' with these parameters: lost after " + std::to_string(time_s) +
                             " s of simulated flight");
  }

 private:
  RigidBody body_;
  TrackingController controller_;
  Trajectory trajectory_;
  double ground_s_, rate_noise_rad_s_;
  Gaussian feedback_;
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
  if (!(step_s >= 2e-5 && step_s <= 0.001)) {
    return Invalid(error, "step_s must be 2e-05 to 0.001 seconds");
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
  if (attitude_rad > 1.0) return Invalid(error, "attitude_rad must be at most 1");
  if (rotor_delay_s > 1.0) return Invalid(error, "rotor_delay_s must be at most 1 second");
  if (!gyro_bias.allFinite()) return Invalid(error, "gyro_bias is not finite");
  if (!accelerometer_bias.allFinite()) return Invalid(error, "accelerometer_bias is not finite");
  if (!std::isfinite(battery_slope_V_s)) return Invalid(error, "battery_slope_V_s is not finite");
  return true;
}

WorldOptions WorldOf(const SimulationOptions& options, const SimulationNoise& noise) {
  const Cut cut(options);
  WorldOptions world;
  world.step_s = cut.step_s();
  world.max_thrust_over_weight = world.idle_speed_share = 0.0;
  world.battery_full_V = world.battery_empty_V = noise.battery_start_V;
  world.battery_resistance_ohm = 0.0;
  world.battery_slope_V_s = noise.battery_slope_V_s;
  world.disturbance_force_N = noise.force_N;
  world.disturbance_torque_Nm = noise.torque_Nm;
  world.ground = options.ground_s > 0.0;
  world.odometry_rate_hz = world.rotor_rate_hz = world.battery_rate_hz = cut.rate_hz();
  world.position_noise_m = noise.position_m;
  world.attitude_noise_rad = noise.attitude_rad;
  world.velocity_noise_m_s = noise.velocity_m_s;
  world.rate_noise_rad_s = noise.rate_rad_s;
  world.odometry_delay_s = 0.0;
  world.imu_rate_hz = noise.imu ? cut.rate_hz() : 0.0;
  world.gyro_noise_density = noise.gyro_noise_density;
  world.accelerometer_noise_density = noise.accelerometer_noise_density;
  world.gyro_bias_rad_s = noise.gyro_bias;
  world.accelerometer_bias_m_s2 = noise.accelerometer_bias;
  world.rotor_noise_rad_s = noise.rotor_speed_rad_s;
  world.rotor_delay_s = noise.rotor_delay_s;
  return world;
}

FlightLog SimulateLog(const DynamicModel& model, const ModelValues& truth,
                      const SimulationOptions& options, const SimulationNoise& noise,
                      const Unmodelled& unmodelled, const TruthSink& truth_sink) {
  std::string error;
  if (!options.IsValid(&error) || !noise.IsValid(&error)) throw std::invalid_argument(error);
  const Cut cut(options);
  World world(model, truth, WorldOf(options, noise), options.seed);
  world.SetUnmodelled(unmodelled);
  Pilot pilot(model, truth, options, noise);
  pilot.Start(&world);
  FlightLog log;
  log.file = options.trajectory;
  Reserve(static_cast<size_t>(cut.samples), noise.imu, &log);
  for (long k = 0; k < cut.samples; ++k) {
    for (int control = 0; control < cut.controls; ++control) {
      pilot.Control(&world);
      if (control == 0) {
        for (const Sample& sample : world.TakeSamples()) Keep(sample, &log);
        truth_sink(world.Truth());
      }
      for (int step = 0; step < cut.steps; ++step) world.Step();
    }
  }
  // Of the last period; what the sensors see at its end is not asked for.
  for (const Sample& sample : world.TakeSamples()) {
    if (std::holds_alternative<CommandSample>(sample)) Keep(sample, &log);
  }
  return log;
}

SimulatedFlight Simulate(const DynamicModel& model, const ModelValues& truth,
                         const SimulationOptions& options, const SimulationNoise& noise,
                         const Unmodelled& unmodelled) {
  SimulatedFlight flight;
  if (options.IsValid(nullptr)) flight.truth.reserve(static_cast<size_t>(Cut(options).samples));
  flight.log = SimulateLog(model, truth, options, noise, unmodelled,
                           [&](const TruthSample& sample) { flight.truth.push_back(sample); });
  return flight;
}

}  // namespace odmc
