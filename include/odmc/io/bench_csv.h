#pragma once

#include <optional>
#include <string>
#include <vector>

#include "odmc/actuator/bench_run.h"

namespace odmc {

/// What a speed column counts.
enum class SpeedUnit {
  kRadPerSecond,
  kRpm,
  kErpm,  ///< electrical revolutions per minute: pole pairs times rpm
};
std::optional<SpeedUnit> SpeedUnitNamed(const std::string& name);  ///< rad_s, rpm, erpm

/// Units and roles of the columns of a bench file, as its user declares them. Columns that are not
/// declared are those of docs/actuator.md, where the file has them: t; pwm_us, pwm, throttle
/// or command, or the same with the motor's number (pwm1_us ..); rotor1 .. or rotor_speed,
/// rotor_optical, rotor_electrical; vbat; thrust_N or thrust_total_N; torque_Nm.
struct BenchColumns {
  CommandUnit command_unit = CommandUnit::kFraction;
  SpeedUnit speed_unit = SpeedUnit::kRadPerSecond;
  int pole_pairs = 0;                       ///< > 0 for kErpm
  std::vector<std::string> command, speed;  ///< one command for all motors, or one each
  std::string time, voltage, thrust, torque;
  bool steady_readings = false;  ///< rows are single readings, whatever their times
  double thrust_unit_N = 1.0;    ///< 9.80665e-3 for grams
};

/// Reads one bench file. Speeds of 0 are left out and counted; so are rows whose time steps back or
/// whose command is missing. Without a column of times rows are steady readings.
/// @param used receives a line per role: "speed: rotor1, rotor2 [rad/s]"; may be null
/// @throws std::invalid_argument naming file, line and column
BenchRun ReadBenchCsv(const std::string& file, const BenchColumns& columns,
                      std::vector<std::string>* used = nullptr);

}  // namespace odmc
