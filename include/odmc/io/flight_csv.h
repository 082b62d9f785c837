#pragma once

#include <string>

#include "odmc/io/flight_read_options.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// Reads a flight in the CSV form of docs/flights.md: columns by header name in any order. A
/// sibling NAME_rotor.csv replaces the rotor columns; NAME_mocap.csv replaces pose and velocity
/// with PoseSource::kMocap (body rates stay, on their own stamps: they become the IMU's gyro unless
/// the file has one). Columns it does not know are named once in the log's warnings and ignored.
/// Rows without a finite t, p, q, short rows and rows that step back in time are dropped and
/// counted; an empty or nan cell elsewhere drops just that stream's sample. No stream is
/// interpolated: each keeps its own stamps.
///
/// `w` columns are body rates of the odometry; `a` columns are an accelerometer at Bo along B; `g`
/// columns are a raw gyro, and then `a` is raw too, both in the IMU frame of the vehicle file.
/// `pwm1_us`.., `pwm1`.. (0 to 65535) or `throttle1`.. (0 to 1) are commands of the ESCs, beside
/// the rotor speeds; a file may have them instead of rotor speeds, whose stream is then empty.
/// `rotor_rms` stands in where single rotors are missing (FlightLog::rotor_rms_only).
///
/// FlightPart::kOnboard: a file without the columns of a pose is read, too; FlightPart::kPoses:
/// only t, p, q, v, w are. Columns rotor1..N of `num_rotors` are expected.
/// @throws std::invalid_argument naming file, line and column: missing columns, nothing usable,
///   numbers that cannot be read, quaternions that are not unit.
FlightLog ReadFlightCsv(const std::string& file, const FlightReadOptions& options);
FlightLog ReadFlightCsv(const std::string& file, int num_rotors, PoseSource pose);

/// Writes a flight in the CSV form of docs/flights.md, one row per odometry stamp, numbers with all
/// their digits. Columns: t, p, q and, where the flight has them, v, w, a, g, rotorN (or
/// rotor_rms), commands, vbat. Streams with the odometry's stamps are written as they are and read
/// back bit-equal. Rotor speeds with other stamps go to the sibling NAME_rotor.csv as they are
/// (else an old sibling is removed, since readers would prefer it). The form has no place for an
/// IMU or battery with other stamps: these are interpolated linearly to the odometry's, and cells
/// outside stay empty; a bag keeps them exactly.
/// @throws std::runtime_error if a file cannot be written, std::invalid_argument without odometry.
void WriteFlightCsv(const FlightLog& log, const std::string& file);

/// "path/NAME.csv" -> "path/NAME" + suffix, as in "path/NAME_rotor.csv".
std::string SiblingFile(const std::string& file, const std::string& suffix);

}  // namespace odmc
