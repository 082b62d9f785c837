#pragma once

#include <string>

#include "odmc/sensing/samples.h"

namespace odmc {

/// \file
/// Writes a flight as an autopilot would have logged it: to try the readers, and to show an
/// autopilot's users what their log should hold. Frames and units are the autopilot's; stamps are
/// moved by whole seconds so that the first one is from 1 s to 2 s on, as a clock since the
/// autopilot's start, and are rounded to microseconds, as logs have them.
/// @throws std::invalid_argument where the flight has neither rotor speeds nor commands,
///   std::runtime_error where the file cannot be written

/// PX4's ULog: vehicle_odometry (with body rates), sensor_combined, esc_status (whole rpm),
/// actuator_motors, battery_status, each at its own stamps, in single precision.
void WriteULog(const FlightLog& log, const std::string& file);

/// ArduPilot's dataflash log: XKF1 and XKQ, IMU, ESC (a message per rotor), RCOU (whole µs), BAT,
/// each at its own stamps, in single precision. Body rates of the odometry replace a missing
/// gyro.
void WriteDataflash(const FlightLog& log, const std::string& file);

/// Blackbox with one frame per IMU sample (without an IMU: per reading of the rotors): a flight
/// with poses as INDIflight writes it (1 mm, 1 cm/s, 1 rad/s), one without as Betaflight does (eRPM
/// hundreds, 14 poles). Streams of other stamps are taken linearly between their samples; frames
/// are where all are known. Body rates of the odometry replace a missing gyro.
void WriteBlackbox(const FlightLog& log, const std::string& file);

}  // namespace odmc
