#pragma once

#include <map>
#include <string>

#include "odmc/io/flight_csv.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// Topics of a bag, by role: odometry, pose, imu, rotor_speeds, joint_states, battery_state. Where a
/// role has no entry, the one topic of a fitting type whose name ends in the role's is taken.
using TopicMap = std::map<std::string, std::string>;

/// How the messages of a bag are to be read; the node's parameters of the same names.
struct BagOptions {
  TopicMap topics;
  std::string twist_frame = "auto";        ///< auto | body | world
  std::string rotor_speed_unit = "rad_s";  ///< of joint_states: rad_s | rpm | erpm
  int pole_pairs = 7;                      ///< for erpm
};

/// Reads a flight from a rosbag; needs no master. Stamps are header stamps.
/// @throws std::invalid_argument naming file and topic: not a bag, truncated, no odometry, no rotor
///   speeds, twist that fits neither frame.
FlightLog ReadFlightBag(const std::string& file, int num_rotors, const BagOptions& options);

/// Reads .bag or .csv by its ending.
FlightLog ReadFlight(const std::string& file, int num_rotors, PoseSource pose,
                     const BagOptions& options);

/// Writes a flight as a bag with the topics odometry, imu, rotor_speeds, battery_state.
void WriteFlightBag(const FlightLog& log, const std::string& file);

}  // namespace odmc
