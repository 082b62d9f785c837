#pragma once

#include <string>
#include <string_view>

#include "odmc/io/flight_reader.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// \file
/// Logs that autopilots write on board. docs/logs.md says which message gives which stream, the
/// frames, and what to set so that the rates suffice. World and body are turned into ours (z up;
/// x forward, y left, z up) while reading; stamps are the autopilot's time since its start. The
/// order of the rotors is the autopilot's.
///
/// All readers drop single rotor readings that leap by a factor, take speeds' magnitudes, and add a
/// line with the streams and their rates to the log's warnings. What is cut off or damaged is
/// skipped and counted there.
/// @throws std::invalid_argument naming file, place and cause: not such a log, no pose, no rotor
///   speeds, a stream that is too slow (with the autopilot's setting that mends it)

/// Blackbox of Betaflight, INDIflight and their relatives (.bfl, .bbl). Betaflight's has no pose
/// and is refused; INDIflight's has. Of several logs in one file the longest is read.
FlightLog ReadBlackbox(const std::string& file, const FlightReadOptions& options);
bool IsBlackbox(std::string_view head);

/// PX4's log (.ulg): vehicle_odometry, or vehicle_local_position with vehicle_attitude;
/// sensor_combined, or vehicle_angular_velocity and vehicle_acceleration; esc_status;
/// actuator_motors or actuator_outputs; battery_status.
FlightLog ReadULog(const std::string& file, const FlightReadOptions& options);
bool IsULog(std::string_view head);

/// ArduPilot's dataflash log (.bin): XKF1 (NKF1) or POS; XKQ (NKQ), ATT or AHR2; IMU; ESC; RCOU;
/// BAT. Of several filters, IMUs and batteries the first is read.
FlightLog ReadDataflash(const std::string& file, const FlightReadOptions& options);
bool IsDataflash(std::string_view head);

}  // namespace odmc
