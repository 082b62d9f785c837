#include "odmc/ros/message_values.h"

#include <array>
#include <cctype>
#include <charconv>
#include <cstdint>
#include <limits>
#include <map>
#include <stdexcept>
#include <string>

namespace odmc {
namespace {

/// The last number in a joint's name; -1 if there is none.
long NumberIn(const std::string& name) {
  size_t end = name.size();
  while (end > 0 && std::isdigit(static_cast<unsigned char>(name[end - 1])) == 0) --end;
  size_t begin = end;
  while (begin > 0 && std::isdigit(static_cast<unsigned char>(name[begin - 1])) != 0) --begin;
  if (begin == end || end - begin > 9) return -1;
  return std::stol(name.substr(begin, end - begin));
}

constexpr Stamp kSecond = 1000000000;

}  // namespace

Stamp FromRos(const ros::Time& time) {
  return static_cast<Stamp>(time.sec) * kSecond + static_cast<Stamp>(time.nsec);
}

ros::Time ToRos(Stamp stamp) {
  if (stamp < 0 || stamp / kSecond > std::numeric_limits<std::uint32_t>::max()) {
    throw std::invalid_argument("a stamp of " + std::to_string(ToSeconds(stamp)) +
                                " s does not fit a ROS message");
  }
  return ros::Time(static_cast<std::uint32_t>(stamp / kSecond),
                   static_cast<std::uint32_t>(stamp % kSecond));
}

Eigen::Vector3d ToEigen(const geometry_msgs::Vector3& v) { return {v.x, v.y, v.z}; }
Eigen::Vector3d ToEigen(const geometry_msgs::Point& p) { return {p.x, p.y, p.z}; }
Eigen::Quaterniond ToEigen(const geometry_msgs::Quaternion& q) {
  return Eigen::Quaterniond(q.w, q.x, q.y, q.z);
}

geometry_msgs::Vector3 ToVector3(const Eigen::Vector3d& v) {
  geometry_msgs::Vector3 m;
  m.x = v.x();
  m.y = v.y();
  m.z = v.z();
  return m;
}

geometry_msgs::Point ToPoint(const Eigen::Vector3d& p) {
  geometry_msgs::Point m;
  m.x = p.x();
  m.y = p.y();
  m.z = p.z();
  return m;
}

geometry_msgs::Quaternion ToQuaternion(const Eigen::Quaterniond& q) {
  geometry_msgs::Quaternion m;
  m.x = q.x();
  m.y = q.y();
  m.z = q.z();
  m.w = q.w();
  return m;
}

std_msgs::Header MakeHeader(Stamp stamp, const std::string& frame) {
  std_msgs::Header header;
  header.stamp = ToRos(stamp);
  header.frame_id = frame;
  return header;
}

double FromFloat(float value) {
  std::array<char, 32> text;
  const auto end = std::to_chars(text.data(), text.data() + text.size(), value).ptr;
  double result = value;
  std::from_chars(text.data(), end, result);
  return result;
}

std::vector<double> SpeedsOfJoints(const sensor_msgs::JointState& message) {
  if (message.name.size() != message.velocity.size()) return message.velocity;
  std::map<long, double> by_number;
  for (size_t i = 0; i < message.name.size(); ++i) {
    const long number = NumberIn(message.name[i]);
    if (number < 0 || !by_number.emplace(number, message.velocity[i]).second) {
      return message.velocity;
    }
  }
  std::vector<double> ordered;
  for (const auto& [number, speed] : by_number) ordered.push_back(speed);
  return ordered;
}

}  // namespace odmc
