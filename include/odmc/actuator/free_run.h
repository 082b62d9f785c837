#pragma once

#include <vector>

#include "odmc/actuator/bench_run.h"

namespace odmc {

/// A longer hole in a recording starts a free run anew, at the next measured speed.
constexpr double kLongestHole_s = 0.5;

/// Speeds of a motor predicted from commands and voltage alone: starts at the first measured speed
/// and never looks at another. Commands hold until the next one and act after the motor's delay.
/// Steady readings (no times) get the steady speed of their row.
/// @param steady receives the speed that the command acting at each row holds; may be null
/// @returns one speed per row [rad/s]
std::vector<double> FreeRun(const Motor& motor, const MotorSignal& signal,
                            std::vector<double>* steady = nullptr);

}  // namespace odmc
