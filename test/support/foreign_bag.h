#pragma once

#include <rosbag/bag.h>
#include <rosbag/view.h>

#include <cmath>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "odmc/MotorCommands.h"
#include "odmc/RotorSpeeds.h"
#include "odmc/ros/message_values.h"
#include "odmc/ros/raw_message.h"
#include "support/message_bytes.h"

namespace odmc::testing_support {

/// \file
/// Bags with rotor speeds in messages of packages that are not installed.

constexpr char kMadeUpField[] = "arms[].esc.erpm";
constexpr int kMadeUpPolePairs = 6;

/// Which entry of the made-up message is rotor 1, 2, 3, 4.
inline std::vector<int> MadeUpOrder() { return {2, 4, 1, 3}; }

inline RawMessage Raw(const std::string& type, const std::string& md5,
                      const std::string& definition, const MessageBytes& bytes) {
  RawMessage message;
  message.bytes = bytes.bytes();
  message.connection = boost::make_shared<std::map<std::string, std::string>>();
  (*message.connection)["type"] = type;
  (*message.connection)["md5sum"] = md5;
  (*message.connection)["message_definition"] = definition;
  return message;
}

inline RawMessage RawActuators(Stamp stamp, const std::vector<double>& speeds) {
  return Raw("mav_msgs/Actuators", "25741daf38ed25442e3a66a855ee8d9c", ActuatorsDefinition(),
             Actuators(stamp, speeds));
}

inline RawMessage RawEscStatus(Stamp stamp, const std::vector<std::int32_t>& rpm) {
  return Raw("mavros_msgs/ESCStatus", "145d49eaf5cfecbdfd50ae4a22fe82d4", EscStatusDefinition(),
             EscStatus(stamp, rpm));
}

/// Four arms in an order of their own, electrical revolutions per minute in single precision, text
/// and arrays before them.
/// @param stamp  of the header; 0: the type has none
inline RawMessage RawMadeUp(Stamp stamp, const std::vector<double>& speeds) {
  const std::string fields =
      "# of nobody's package\nstring CODE=#1 = not a comment\nbool armed\n"
      "uint8[] spare\nArm[4] arms\nuint16 crc\n";
  const std::string definition =
      With(With(stamp == 0 ? fields : WithHeader("Header header\n" + fields), "garage_quad/Arm",
                "string name\nEsc esc\nfloat32[3] hub_m\n"),
           "garage_quad/Esc", "int16 temperature\nduration on\nfloat32 erpm\n");
  std::vector<float> erpm(4);
  for (size_t i = 0; i < 4; ++i) {
    erpm[static_cast<size_t>(MadeUpOrder()[i]) - 1] =
        static_cast<float>(speeds[i] * 30.0 / M_PI * kMadeUpPolePairs);
  }
  MessageBytes bytes;
  if (stamp != 0) bytes.AddHeader(stamp, "base_link");
  bytes.Add(std::uint8_t{1}).AddArray<std::uint8_t>({1, 2, 3});
  for (size_t i = 0; i < 4; ++i) {
    bytes.AddText("arm" + std::to_string(i)).Add(std::int16_t{-5}).AddStamp(1000000000);
    bytes.Add(erpm[i]).Add(0.1f).Add(0.2f).Add(0.3f);
  }
  bytes.Add(std::uint16_t{65535});
  return Raw("garage_quad/Motors", "0123456789abcdef0123456789abcdef", definition, bytes);
}

/// Copies a bag of WriteFlightBag() with its rotor speeds as
///   actuators   mav_msgs/Actuators on /motor_speed, with the sign of the spin
///   esc_status  mavros_msgs/ESCStatus on /mavros/esc_status, whole rpm
///   made_up     a type of our own on /garage/motors, without a stamp, recorded at its time
///   made_up_stamped  the same with a header
/// and commands on a topic that must not be taken for them.
inline void WriteForeign(const std::string& from, const std::string& to, const std::string& kind) {
  rosbag::Bag in(from, rosbag::bagmode::Read), out(to, rosbag::bagmode::Write);
  for (const rosbag::MessageInstance& m : rosbag::View(in)) {
    const auto rotors = m.instantiate<RotorSpeeds>();
    if (rotors == nullptr) {
      out.write(m.getTopic(), m.getTime(), m);
      continue;
    }
    const Stamp stamp = FromRos(rotors->header.stamp);
    std::vector<double> speeds = rotors->angular_velocity_rad_s;
    if (kind == "actuators") {
      out.write("/command/motor_speed", m.getTime(), RawActuators(stamp, {1, 2, 3, 4}));
      for (size_t i = 0; i < speeds.size(); i += 2) speeds[i] = -speeds[i];
      out.write("/motor_speed", m.getTime(), RawActuators(stamp, speeds));
    } else if (kind == "esc_status") {
      std::vector<std::int32_t> rpm;
      for (const double speed : speeds) {
        rpm.push_back(static_cast<std::int32_t>(std::lround(speed * 30.0 / M_PI)));
      }
      out.write("/mavros/esc_status", m.getTime(), RawEscStatus(stamp, rpm));
    } else {
      out.write("/garage/motors", m.getTime(), RawMadeUp(kind == "made_up" ? 0 : stamp, speeds));
    }
  }
}

}  // namespace odmc::testing_support
