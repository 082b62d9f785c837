#pragma once

#include <string>

#include "odmc/sensing/samples.h"

namespace odmc {

/// Which pose of a flight to use.
enum class PoseSource {
  kEkf,    ///< the main file's pose and twist
  kMocap,  ///< NAME_mocap.csv beside it: pose only
};

/// Reads a flight in the CSV form of the data README: columns by header name in any order. A sibling
/// NAME_rotor.csv replaces the rotor columns; NAME_mocap.csv replaces pose and velocity with
/// PoseSource::kMocap (body rates stay). Columns it does not know are named once in the log's
/// warnings and ignored. Rows that are not finite or step back in time are dropped and counted.
///
/// `w` columns are body rates of the odometry; `a` columns are an accelerometer at Bo along B; `g`
/// columns are a raw gyro, and then `a` is raw too, both in the IMU frame of the vehicle file.
/// `rotor_rms` stands in where single rotors are missing (FlightLog::rotor_rms_only).
///
/// @param num_rotors columns rotor1..N expected
/// @throws std::invalid_argument naming file, line and column: missing columns, nothing usable,
///   numbers that cannot be read, quaternions that are not unit.
FlightLog ReadFlightCsv(const std::string& file, int num_rotors, PoseSource pose);

}  // namespace odmc
