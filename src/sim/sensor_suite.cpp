#include "odmc/sim/sensor_suite.h"

#include <algorithm>
#include <cmath>

#include "odmc/sim/random_streams.h"

namespace odmc {
namespace {

constexpr size_t kRoom = 4096;  // samples that wait for Take() before memory is asked for

}  // namespace

bool SampleClock::Tick(Stamp now) {
  if (rate_hz_ <= 0.0 || now < next_) return false;
  ++count_;
  next_ = static_cast<Stamp>(std::llround(static_cast<double>(count_) * (1e9 / rate_hz_)));
  return true;
}

RotorHistory::RotorHistory(double delay_s, double step_s)
    : steps_back_(delay_s / step_s), ring_(static_cast<size_t>(steps_back_) + 2) {}

void RotorHistory::Push(const RotorVector& speed) {
  ring_[static_cast<size_t>(count_) % ring_.size()] = speed;
  ++count_;
}

const RotorVector& RotorHistory::StepsAgo(long steps) const {
  return ring_[static_cast<size_t>(std::max(0L, count_ - 1 - steps)) % ring_.size()];
}

RotorVector RotorHistory::Delayed() const {
  const long whole = static_cast<long>(steps_back_);
  const double share = steps_back_ - static_cast<double>(whole);
  return (1.0 - share) * StepsAgo(whole) + share * StepsAgo(whole + 1);
}

void Keep(const Sample& sample, FlightLog* log) {
  struct {
    FlightLog* log;
    void operator()(const OdometrySample& s) const { log->odometry.push_back(s); }
    void operator()(const ImuSample& s) const { log->imu.push_back(s); }
    void operator()(const RotorSample& s) const { log->rotors.push_back(s); }
    void operator()(const BatterySample& s) const { log->battery.push_back(s); }
    void operator()(const CommandSample& s) const { log->commands.push_back(s); }
  } const keep{log};
  std::visit(keep, sample);
}

SensorSuite::SensorSuite(const WorldOptions& options, int seed)
    : options_(options),
      odometry_noise_{options.position_noise_m, options.attitude_noise_rad,
                      options.velocity_noise_m_s, options.rate_noise_rad_s},
      imu_noise_{options.gyro_noise_density * std::sqrt(options.imu_rate_hz),
                 options.accelerometer_noise_density * std::sqrt(options.imu_rate_hz),
                 options.gyro_bias_rad_s, options.accelerometer_bias_m_s2},
      odometry_clock_(options.odometry_rate_hz),
      imu_clock_(options.imu_rate_hz),
      rotor_clock_(options.rotor_rate_hz),
      command_clock_(options.rotor_rate_hz),
      battery_clock_(options.battery_rate_hz),
      odometry_random_(seed, kOdometryStream),
      drift_random_(seed, kDriftStream),
      imu_random_(seed, kImuStream),
      rotor_random_(seed, kRotorStream),
      history_(options.rotor_delay_s, options.step_s),
      odometry_delay_(FromSeconds(options.odometry_delay_s)) {
  const double waiting = options.odometry_delay_s * options.odometry_rate_hz;
  on_the_way_.reserve(static_cast<size_t>(waiting) + 2);
  arrived_.reserve(kRoom);
}

void SensorSuite::SenseImu(const TruthSample& truth, const BodyProperties& properties) {
  ImuSample sample = ImuOf(truth, properties);
  AddNoise(imu_noise_, &imu_random_, &sample);
  arrived_.emplace_back(sample);
}

void SensorSuite::Drift() {
  if (options_.position_drift_m_sqrt_s == 0.0 && options_.yaw_drift_rad_sqrt_s == 0.0) return;
  const double root_period = 1.0 / std::sqrt(options_.odometry_rate_hz);
  offset_.p_W += options_.position_drift_m_sqrt_s * root_period * drift_random_.Next3();
  offset_.yaw += options_.yaw_drift_rad_sqrt_s * root_period * drift_random_.Next();
}

void SensorSuite::SenseOdometry(Stamp now, const RigidBodyState& state,
                                const BodyProperties& properties) {
  OdometrySample sample = OdometryOf(now, state, properties);
  const Eigen::Quaterniond turn(Eigen::AngleAxisd(offset_.yaw, Eigen::Vector3d::UnitZ()));
  sample.p_WS = turn * sample.p_WS + offset_.p_W;
  sample.q_WS = turn * sample.q_WS;
  sample.v_WS = turn * *sample.v_WS;
  AddNoise(odometry_noise_, &odometry_random_, &sample);
  on_the_way_.push_back(sample);
  Drift();
}

void SensorSuite::SenseRotors(Stamp now) {
  RotorVector speed = history_.Delayed();
  AddNoise(options_.rotor_noise_rad_s, &rotor_random_, &speed);
  const double quantum = options_.rotor_quantum_rad_s;
  if (quantum > 0.0) speed = ((speed / quantum).array().round() * quantum).matrix();
  arrived_.emplace_back(RotorSample{now, speed});
}

void SensorSuite::SenseCommands(Stamp now, const RotorVector& throttle) {
  const bool is_due = command_clock_.Tick(now);
  if (!is_due && !command_came_) return;
  command_came_ = false;
  arrived_.emplace_back(CommandSample{now, throttle});
}

void SensorSuite::Deliver(Stamp now) {
  const auto is_late = [&](const OdometrySample& s) { return s.stamp + odometry_delay_ > now; };
  const auto end = std::find_if(on_the_way_.begin(), on_the_way_.end(), is_late);
  arrived_.insert(arrived_.end(), on_the_way_.begin(), end);
  on_the_way_.erase(on_the_way_.begin(), end);
}

// Copied out, so that the room stays for the steps to come.
std::vector<Sample> SensorSuite::Take() {
  const std::vector<Sample> taken(arrived_);
  arrived_.clear();
  return taken;
}

}  // namespace odmc
