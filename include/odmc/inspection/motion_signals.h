#pragma once

#include <optional>
#include <vector>

#include "odmc/inspection/sampled_signal.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// The streams of a recording as signals over seconds after its first pose, each on its own stamps.
/// Of recordings longer than `kLongestLook_s` stretches spread evenly over the whole are taken, so
/// that time and memory stay bounded.
struct MotionSignals {
  SampledSignal position;                      ///< p_WS, 3 channels [m]
  SampledSignal attitude;                      ///< q_WS as x, y, z, w; sign continuous
  std::optional<SampledSignal> velocity;       ///< v_WS as recorded [m/s]
  std::optional<SampledSignal> rates;          ///< w_WS_S as recorded [rad/s]
  std::optional<SampledSignal> gyro;           ///< in I [rad/s]
  std::optional<SampledSignal> accelerometer;  ///< in I [m/s²]
  std::optional<SampledSignal> rotors;         ///< squares of the speeds [rad²/s²]

  /// Orientation of S at `t_s`.
  Eigen::Quaterniond q_WS(double t_s) const;
};

constexpr double kLongestLook_s = 120.0;

/// Seconds from the first pose on, which the flight must have.
double FlightSeconds(Stamp stamp, const FlightLog& log);

/// Empty where there are fewer than 5 different poses.
std::optional<MotionSignals> SignalsOf(const FlightLog& log);

/// Velocity from differences of position: at the middle of neighbouring poses, so without delay.
SampledSignal DifferencesOf(const SampledSignal& position);

/// Rates from differences of attitude, in the sensor's own frame, at the middle of neighbouring
/// poses.
SampledSignal TurnsOf(const SampledSignal& attitude);

/// Where the vehicle moves while its rotors turn as fast as in flight, in steps of kFlightStep_s
/// from the first pose on. Standing (with rotors turning or not), lying and being carried with
/// rotors off are not among it.
std::vector<bool> FindFlight(const MotionSignals& signals);

constexpr double kFlightStep_s = 0.25;

/// True if FindFlight() found flight at the time `t_s`, from the first pose on.
bool IsInFlight(const std::vector<bool>& flight, double t_s);

}  // namespace odmc
