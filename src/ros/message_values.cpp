#include "odmc/ros/message_values.h"

#include <array>
#include <charconv>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <string>

namespace odmc {
namespace {

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

double FromFloat(float value) {
  std::array<char, 32> text;
  const auto end = std::to_chars(text.data(), text.data() + text.size(), value).ptr;
  double result = value;
  std::from_chars(text.data(), end, result);
  return result;
}

}  // namespace odmc
