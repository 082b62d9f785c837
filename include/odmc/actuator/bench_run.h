#pragma once

#include <string>
#include <vector>

#include "odmc/model/motor.h"

namespace odmc {

/// What one file says about actuators: a bench run, a thrust stand, or a flight. Rows in the order
/// of recording. NaN marks single values that are missing.
struct BenchRun {
  std::string file;  ///< name, without its folder
  CommandUnit command_unit = CommandUnit::kFraction;
  std::vector<double> t_s;  ///< increasing; empty: rows are single steady readings
  std::vector<std::vector<double>> throttle;     ///< one column for all motors, or one each
  std::vector<std::vector<double>> speed_rad_s;  ///< one column per motor, > 0 or NaN
  std::vector<double> voltage_V;                 ///< empty: not recorded
  std::vector<double> thrust_N, torque_Nm;       ///< of all motors together; empty: not recorded
  long rows = 0;                                 ///< in the file
  long zero_speed = 0;                           ///< speeds of 0, left out
  long dropped = 0;                              ///< rows that could not be used

  int num_motors() const { return static_cast<int>(speed_rad_s.size()); }
  size_t size() const { return throttle.front().size(); }
  const std::vector<double>& ThrottleOfMotor(int motor) const {
    return throttle[throttle.size() == 1 ? 0 : static_cast<size_t>(motor)];
  }
};

/// One motor's part of a run.
struct MotorSignal {
  std::vector<double> t_s;  ///< empty: steady readings
  std::vector<double> throttle, voltage_V, speed_rad_s;
};

/// Throttle and speed of one motor, voltages filled in: those that are missing repeat the last one;
/// 1 where none was recorded or `uses_voltage` is false.
MotorSignal SignalOf(const BenchRun& run, int motor, bool uses_voltage);

}  // namespace odmc
