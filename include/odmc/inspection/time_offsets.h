#pragma once

#include <string>
#include <vector>

#include "odmc/inspection/lag_regression.h"
#include "odmc/inspection/motion_signals.h"
#include "odmc/model/vehicle.h"

namespace odmc {

/// How late a stream is stamped, as another one tells. Its stamps minus `lag_s` are right.
struct TimeOffset {
  std::string stream;   ///< "rotor_speeds", "body_rates", "velocity", "gyro", "accelerometer"
  std::string against;  ///< "body_rates", "gyro", "attitude", "position", "velocity"
  StreamLag lag;        ///< lag_s > 0: late
  double compensated_s = 0.0;
};

/// Velocity against the derivative of position.
std::optional<TimeOffset> VelocityOffset(const MotionSignals& signals,
                                         const std::vector<bool>& flight);

/// Body rates or gyro against the derivative of attitude.
std::optional<TimeOffset> RatesOffset(const MotionSignals& signals,
                                      const std::vector<bool>& flight);
std::optional<TimeOffset> GyroOffset(const MotionSignals& signals, const std::vector<bool>& flight);

/// Accelerometer against gravity and the derivative of velocity.
std::optional<TimeOffset> AccelerometerOffset(const MotionSignals& signals, const Vehicle& vehicle,
                                              const std::vector<bool>& flight);

/// Rotor speeds against roll and pitch acceleration, each rotor with a torque of its own, so that
/// neither order, spins, inertia nor k_f enter.
std::optional<TimeOffset> RotorOffset(const MotionSignals& signals, const Vehicle& vehicle,
                                      const std::vector<bool>& flight);

/// The same against the acceleration along the thrust axis.
std::optional<TimeOffset> ThrustOffset(const MotionSignals& signals, const Vehicle& vehicle,
                                       const std::vector<bool>& flight);

/// Mean of two offsets of one stream, weighed by their precision; the sigma grows where they
/// contradict each other. One that is not determined leaves the other.
std::optional<TimeOffset> CombinedOffset(const std::optional<TimeOffset>& a,
                                         const std::optional<TimeOffset>& b);

}  // namespace odmc
