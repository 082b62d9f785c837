#include "odmc/bench/undeclared_recording.h"

#include <algorithm>
#include <cmath>

#include "../effects/rotor_air.h"
#include "odmc/math/gaussian.h"
#include "odmc/math/so3.h"
#include "odmc/math/units.h"

namespace odmc {
namespace {

using Eigen::Vector3d;

constexpr int kNoiseStream = 202, kConditionStream = 204, kSlowStream = 205, kJitterStream = 206;
constexpr double kShareAsWhite = 0.25;
constexpr double kMostJitter = 0.4;  // sample periods: samples keep their order

/// A number between `low` and `high`, all alike.
double Between(double low, double high, Gaussian* random) {
  return low + (high - low) * 0.5 * std::erfc(-random->Next() / std::sqrt(2.0));
}

/// Between `low` and `high`, all octaves alike.
double OctavesBetween(double low, double high, Gaussian* random) {
  return std::exp(Between(std::log(low), std::log(high), random));
}

Vector3d BetweenEach(double size, Gaussian* random) {
  const double x = Between(-size, size, random), y = Between(-size, size, random);
  return {x, y, Between(-size, size, random)};
}

RecordingConditions White(int seed, const Vehicle& vehicle) {
  Gaussian random(seed, kNoiseStream);
  const auto around = [&random](double size) { return size * std::exp(0.3 * random.Next()); };
  RecordingConditions c;
  c.noise.position_m = around(0.005);
  c.noise.attitude_rad = around(0.002);
  c.noise.velocity_m_s = around(0.02);
  c.noise.rate_rad_s = around(0.01);
  c.noise.rotor_speed_rad_s = around(0.002 * HoverSpeed(vehicle));
  c.noise.force_N = around(0.05);
  c.noise.torque_Nm = around(0.001);
  return c;
}

/// Velocity noise of `size`, of whose variance `share` is slow.
void SplitVelocity(double size, double share, RecordingConditions* c) {
  c->noise.velocity_m_s = size * std::sqrt(1.0 - share);
  c->slow_velocity_m_s = size * std::sqrt(share);
}

// Ranges are judgement, not fitted to recordings: onboard estimators and motion capture give 100 to
// 400 Hz; mounts anywhere on a quadrotor of that size; an
// estimator's velocity drifts over some tenths of a second to seconds; ESC telemetry counts 100
// electrical turns a minute, with 6 to 12 pole pairs 0.9 to 1.8 rad/s, coarser where a logger
// rounds; gyros keep 2 to 20 mrad/s of vibration behind an autopilot's filter; stamps given by an
// operating system without real time are off by 0.05 to 0.5 ms. The pilot is up to 20 % slower or
// faster than the usual one.
RecordingConditions Drawn(int seed, const Vehicle& vehicle) {
  constexpr double kRates_Hz[] = {100.0, 200.0, 250.0, 400.0};
  RecordingConditions c = White(seed, vehicle);
  Gaussian random(seed, kConditionStream);
  if (Between(0.0, 1.0, &random) < kShareAsWhite) return c;
  c.model = RecordingModel::kDrawn;
  c.log_rate_hz = kRates_Hz[std::min(3, static_cast<int>(Between(0.0, 4.0, &random)))];
  c.pilot_bandwidth = OctavesBetween(0.8, 1.2, &random);
  c.odometry.p_BS = BetweenEach(0.5 * vehicle.ArmLength(), &random);
  c.odometry.q_BS = Eigen::Quaterniond(Exp(BetweenEach(0.2, &random)));
  SplitVelocity(c.noise.velocity_m_s, Between(0.0, 0.7, &random), &c);
  c.slow_time_constant_s = OctavesBetween(0.3, 3.0, &random);
  c.rotor_quantum_rad_s = OctavesBetween(0.5, 3.0, &random);
  c.vibration_rad_s = OctavesBetween(0.002, 0.02, &random);
  c.stamp_jitter_s = OctavesBetween(5e-5, 5e-4, &random);
  return c;
}

/// As the README of the recorded data's independent_simulator states.
RecordingConditions Independent(int seed, const Vehicle& vehicle) {
  Gaussian random(seed, kConditionStream);
  RecordingConditions c;
  c.model = RecordingModel::kIndependent;
  c.log_rate_hz = 200.0;
  c.noise.position_m = Between(0.003, 0.01, &random);
  c.noise.attitude_rad = Between(0.1, 0.3, &random) * kDegree;
  SplitVelocity(Between(0.02, 0.04, &random), 0.5, &c);
  c.slow_time_constant_s = Between(0.7, 1.5, &random);
  c.noise.rate_rad_s = Between(0.01, 0.03, &random);
  c.noise.rotor_speed_rad_s = 0.003 * HoverSpeed(vehicle);
  c.noise.force_N = c.noise.torque_Nm = 0.0;
  c.noise.imu = true;
  const double root_rate = std::sqrt(c.log_rate_hz);
  c.noise.gyro_noise_density = Between(0.006, 0.018, &random) / root_rate;
  c.noise.accelerometer_noise_density = Between(0.15, 0.45, &random) / root_rate;
  c.noise.gyro_bias = BetweenEach(0.01, &random);
  c.noise.accelerometer_bias = BetweenEach(0.05, &random);
  c.imu.emplace();
  c.imu->p_BS = BetweenEach(0.04, &random);
  c.imu->q_BS = Eigen::Quaterniond(Exp(BetweenEach(0.02, &random)));
  return c;
}

void AddSlowVelocity(const RecordingConditions& c, Gaussian* random, FlightLog* log) {
  const double keep = std::exp(-1.0 / (c.log_rate_hz * c.slow_time_constant_s));
  Vector3d slow_W = c.slow_velocity_m_s * random->Next3();
  for (OdometrySample& sample : log->odometry) {
    *sample.v_WS += slow_W;
    slow_W = keep * slow_W + c.slow_velocity_m_s * std::sqrt(1.0 - keep * keep) * random->Next3();
  }
}

/// Each rotor shakes the body about an axis of its own, once a turn.
void AddVibration(const RecordingConditions& c, Gaussian* random, FlightLog* log) {
  if (log->rotors.empty()) return;
  const Eigen::Index n = log->rotors.front().speed.size();
  Eigen::Matrix3Xd axes(3, n);
  for (Eigen::Index j = 0; j < n; ++j) axes.col(j) = random->Next3().normalized();
  Eigen::VectorXd phase = Eigen::VectorXd::Zero(n);
  for (size_t i = 0; i < log->odometry.size(); ++i) {
    *log->odometry[i].w_WS_S += c.vibration_rad_s * axes * phase.array().sin().matrix();
    phase += log->rotors[i].speed / c.log_rate_hz;
  }
}

void Quantize(double quantum, FlightLog* log) {
  for (RotorSample& sample : log->rotors) {
    sample.speed = ((sample.speed / quantum).array().round() * quantum).matrix();
  }
}

template <typename Samples>
void Jitter(const RecordingConditions& c, Gaussian* random, Samples* samples) {
  const double most_s = kMostJitter / c.log_rate_hz;
  for (size_t i = 1; i < samples->size(); ++i) {
    const double error_s = std::clamp(c.stamp_jitter_s * random->Next(), -most_s, most_s);
    (*samples)[i].stamp += FromSeconds(error_s);
  }
}

}  // namespace

const char* NameOf(RecordingModel model) {
  switch (model) {
    case RecordingModel::kWhite:
      return "white";
    case RecordingModel::kDrawn:
      return "drawn";
    default:
      return "independent";
  }
}

RecordingConditions DrawRecording(RecordingModel model, int seed, const Vehicle& vehicle) {
  switch (model) {
    case RecordingModel::kWhite:
      return White(seed, vehicle);
    case RecordingModel::kDrawn:
      return Drawn(seed, vehicle);
    default:
      return Independent(seed, vehicle);
  }
}

void Degrade(const RecordingConditions& c, int seed, FlightLog* log) {
  Gaussian slow(seed, kSlowStream), jitter(seed, kJitterStream);
  if (c.slow_velocity_m_s > 0.0) AddSlowVelocity(c, &slow, log);
  if (c.vibration_rad_s > 0.0) AddVibration(c, &slow, log);
  if (c.rotor_quantum_rad_s > 0.0) Quantize(c.rotor_quantum_rad_s, log);
  if (c.stamp_jitter_s > 0.0) {
    Jitter(c, &jitter, &log->odometry);
    Jitter(c, &jitter, &log->rotors);
  }
}

void DeclareSensors(const RecordingConditions& c, Vehicle* vehicle) {
  constexpr double kMeasured_m = 0.001;
  vehicle->odometry = c.odometry;
  // A mount that is declared was measured.
  if (!c.odometry.p_BS.isZero(0.0)) vehicle->odometry.p_BS_sigma_m = kMeasured_m;
  if (!c.imu) return;
  vehicle->imu.emplace();
  vehicle->imu->estimate = true;
  vehicle->effects.push_back("imu_extrinsics");
}

}  // namespace odmc
