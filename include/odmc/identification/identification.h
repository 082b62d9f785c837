#pragma once

#include <optional>
#include <string>
#include <vector>

#include "odmc/actuator/bench_run.h"

namespace odmc {

/// A free run closer than this share of the speed range to its steady speed is in a steady phase.
constexpr double kSteadyShare = 0.01;

/// Error of free runs, of speeds that are not outliers.
struct FreeRunError {
  double steady_rad_s = 0.0, response_rad_s = 0.0, all_rad_s = 0.0;  ///< RMS
  double speed_range_rad_s = 0.0, mean_speed_rad_s = 0.0;            ///< measured
  long steady = 0, response = 0;                                     ///< speeds behind each
  long outliers = 0;                                                 ///< farther off than 8 sigma
};

/// A parameter of the actuator as reports show it; no value where the run can't give it.
struct ActuatorParameter {
  std::string name, unit;
  std::optional<MeasuredValue> found;
};

/// One motor, or all of a vehicle taken as one type, fitted to everything measured.
struct MotorFit {
  Motor motor;
  FreeRunError error;
  /// S_0, S_1, S_2, U_a (in the command's unit), time_constant_s (at the mean speed), delay_s.
  std::vector<ActuatorParameter> parameters;
  /// Of speed behind command, where changes of both correlate best.
  std::optional<double> lag_s;
};

/// What calibrate_actuator finds of motors and ESCs.
struct ActuatorFit {
  CommandUnit command_unit = CommandUnit::kFraction;
  bool uses_voltage = false;  ///< false: not recorded
  bool has_time = false;      ///< false: steady readings only, nothing is known of the dynamics
  MotorFit common;  ///< all motors as one type; its parameters are the mean of each one's own
  std::vector<MotorFit> motors;      ///< each by itself; one only: the same as `common`
  std::vector<double> step_times_s;  ///< of command edges in the first run, delay not counted
};

/// Fits the map of the ESC and the motor's dynamics to all runs at once. First U_a and the delay
/// are scanned, the rest being linear in the midpoint rule (variable projection); then all are
/// refined so that free runs from commands and voltage come closest to the measured speeds. Robust
/// to outliers. Weak priors (a motor's time constant is 5 to 200 ms) hold what the runs don't show;
/// such parameters are reported without a value.                          model.md section 11
/// @param runs at least one; all of the same motors, in the same order
/// @throws std::invalid_argument naming the file: other numbers of motors, no usable speed, a
///   command that never changes
ActuatorFit IdentifyActuator(const std::vector<BenchRun>& runs);

/// Error of free runs of `motor` over these signals.
FreeRunError ErrorOfFreeRun(const Motor& motor, const std::vector<MotorSignal>& signals);

/// Times at which a command leaves a step it has held for 0.3 s [s], at once or slewing; empty if
/// less than half of the run is held.
std::vector<double> StepTimes(const MotorSignal& signal);

/// Lag at which changes of speed correlate best with changes of the command, -20 to 200 ms [s];
/// empty where rows are more than 25 ms apart.
std::optional<double> CorrelationLag(const MotorSignal& signal);

}  // namespace odmc
