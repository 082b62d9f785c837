#pragma once

#include <Eigen/Core>
#include <vector>

#include "odmc/math/gaussian.h"
#include "odmc/sensing/samples.h"
#include "odmc/sim/sensors.h"
#include "odmc/sim/world_options.h"

namespace odmc {

/// When a stream takes samples: from 0 on at a rate, each at the first step that reaches its time.
class SampleClock {
 public:
  /// @param rate_hz 0: never
  explicit SampleClock(double rate_hz) : rate_hz_(rate_hz) {}

  /// True if a sample is due; to be asked once per step, in the order of time.
  bool Tick(Stamp now);

 private:
  double rate_hz_;
  long count_ = 0;
  Stamp next_ = 0;
};

/// Speeds of the last steps.
class RotorHistory {
 public:
  /// Keeps what it takes to look back by `delay_s`; before the start, speeds were as first told.
  RotorHistory(double delay_s, double step_s);

  /// Takes the speeds of the next step (n×1, rad/s).
  void Push(const RotorVector& speed);

  /// Speeds `delay_s` ago, between steps on a straight line.
  RotorVector Delayed() const;

 private:
  const RotorVector& StepsAgo(long steps) const;

  double steps_back_;
  long count_ = 0;
  std::vector<RotorVector> ring_;
};

/// Errors of an odometry that stay: drift and jumps.
struct OdometryOffset {
  Eigen::Vector3d p_W = Eigen::Vector3d::Zero();  ///< [m]
  double yaw = 0.0;                               ///< about the origin of W [rad]
};

/// Puts a sample to its stream.
void Keep(const Sample& sample, FlightLog* log);

/// The sensors of a World: each with its rate, its errors, its delay and its own random numbers.
class SensorSuite {
 public:
  SensorSuite(const WorldOptions& options, int seed);

  /// Takes what is due in `state`; to be asked once per step.
  /// @param truth a function without arguments that gives the TruthSample of this step
  template <typename Truth>
  void Sense(Stamp now, const RigidBodyState& state, const BodyProperties& properties,
             double voltage_V, const Truth& truth) {
    history_.Push(state.rotor_speed);
    if (imu_clock_.Tick(now)) SenseImu(truth(), properties);
    if (odometry_clock_.Tick(now)) SenseOdometry(now, state, properties);
    if (rotor_clock_.Tick(now)) SenseRotors(now);
    if (battery_clock_.Tick(now)) arrived_.emplace_back(BatterySample{now, voltage_V});
    if (!on_the_way_.empty()) Deliver(now);
  }

  /// Takes what the ESCs are told from `now` on, if it was just told or is due at the rate of the
  /// rotors; to be asked once per step, before it. Only for vehicles with an actuator.
  void SenseCommands(Stamp now, const RotorVector& throttle);
  /// There is a new command.
  void CommandCame() { command_came_ = true; }

  /// Positions of the odometry are off by this from now on, in W [m].
  void Jump(const Eigen::Vector3d& by_m) { offset_.p_W += by_m; }

  /// What arrived since the last call.
  std::vector<Sample> Take();

 private:
  void SenseImu(const TruthSample& truth, const BodyProperties& properties);
  void SenseOdometry(Stamp now, const RigidBodyState& state, const BodyProperties& properties);
  void SenseRotors(Stamp now);
  void Drift();
  // Moves odometry that has been on its way for long enough.
  void Deliver(Stamp now);

  WorldOptions options_;
  OdometryErrors odometry_noise_;
  ImuErrors imu_noise_;
  SampleClock odometry_clock_, imu_clock_, rotor_clock_, command_clock_, battery_clock_;
  bool command_came_ = false;
  Gaussian odometry_random_, drift_random_, imu_random_, rotor_random_;
  OdometryOffset offset_;
  RotorHistory history_;
  Stamp odometry_delay_;
  std::vector<OdometrySample> on_the_way_;  // in the order of stamps
  std::vector<Sample> arrived_;
};

}  // namespace odmc
