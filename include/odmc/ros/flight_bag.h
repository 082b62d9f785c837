#pragma once

#include <map>
#include <string>

#include "odmc/io/flight_reader.h"
#include "odmc/ros/streams.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// Topics of a bag, by role: odometry, pose, imu, rotor_speeds, joint_states, battery_state,
/// motor_commands, twist. Where a role has no entry, the one topic of a fitting type whose name
/// ends in the role's is taken, else the one topic of that type; for rotor_speeds, motor_commands
/// and battery_state then of a foreign type that is known (foreign_messages.h). Several are an
/// error that names them and the flag `--topic ROLE:=/name`. `twist`, the velocity of `pose`, is
/// never looked for.
using TopicMap = std::map<std::string, std::string>;

/// How the messages of a bag are to be read; the node's parameters of the same names.
struct BagOptions : StreamOptions {
  TopicMap topics;
  std::string twist_frame = "auto";  ///< auto | body | world
};

/// Reads a flight from a rosbag; needs no master. Stamps are header stamps; messages of other
/// packages without one have the time of recording. `pose` serves where there is no odometry or
/// only `pose` is mapped, with the velocity of `twist` where that is mapped; `joint_states` where
/// there is no rotor_speeds or only joint_states is mapped; a bag with motor_commands may have
/// neither, and the flight then has no rotor samples. Twist covariance[0] = -1 marks an odometry
/// without velocity, [21] = -1 one without body rates, Imu covariances as in REP-145. The frame of
/// the velocity is found as twist_frame.h says.
/// @throws std::invalid_argument naming file and topic: not a bag, truncated, no odometry, no rotor
///   speeds, twist that fits neither frame.
FlightLog ReadFlightBag(const std::string& file, int num_rotors, const BagOptions& options);

/// Reads only what actuators are identified from: motor_commands, rotor speeds, battery voltage.
/// The number of rotors is that of the commands.
/// @throws std::invalid_argument as ReadFlightBag(), also where there are no commands
FlightLog ReadActuatorBag(const std::string& file, const BagOptions& options);

/// The core's formats (flight_reader.h) and rosbags, read with these options.
FlightReaders AllFlightReaders(const BagOptions& options);

/// Reads a flight of any format. PoseSource::kMocap takes a bag's `pose` topic.
FlightLog ReadFlight(const std::string& file, int num_rotors, PoseSource pose,
                     const BagOptions& options);

/// Writes a flight as a bag with the topics /odometry, /imu, /rotor_speeds, /battery_state,
/// /motor_commands.
///
/// ReadFlightBag() gives the same flight back: stamps and doubles to the last bit, voltages to the
/// seven digits of the message's single precision. Two choices serve this. ROS stamps can't be 0 or
/// negative, so a flight that starts before 1 s is moved by whole seconds, and the shift is kept in
/// the topic /stamp_shift (std_msgs/Int64, nanoseconds), which only the reader uses: players and
/// nodes see a flight with the same spacing. Velocity is written in the world frame, declared by
/// child_frame_id = frame_id, since turning it would round it.
/// @throws std::runtime_error if the file cannot be written
void WriteFlightBag(const FlightLog& log, const std::string& file);

}  // namespace odmc
