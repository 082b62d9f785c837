#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <initializer_list>
#include <string>

/// A made-up flight and bytes, for tests that write an autopilot's log.
namespace odmc::testing_support {

/// A number as it lies in memory, little-endian.
template <typename Value>
std::string Raw(Value value) {
  std::string bytes(sizeof value, '\0');
  std::memcpy(bytes.data(), &value, sizeof value);
  return bytes;
}

inline std::string Floats(std::initializer_list<double> values) {
  std::string bytes;
  for (const double value : values) bytes += Raw(static_cast<float>(value));
  return bytes;
}

// Where the vehicle is at a time [s], in NED, its body FRD.
inline Eigen::Vector3d PositionNed(double t) {
  return {2.0 * std::sin(t), 1.0 + t, -3.0 - 0.5 * t};
}
inline Eigen::Vector3d VelocityNed(double t) { return {2.0 * std::cos(t), 1.0, -0.5}; }
/// Roll, pitch, yaw [rad].
inline Eigen::Vector3d Angles(double t) { return {0.1, 0.2 * std::sin(t), 0.5 + 0.3 * t}; }
inline Eigen::Quaterniond AttitudeNed(double t) {
  return Eigen::AngleAxisd(Angles(t).z(), Eigen::Vector3d::UnitZ()) *
         Eigen::AngleAxisd(Angles(t).y(), Eigen::Vector3d::UnitY()) *
         Eigen::AngleAxisd(Angles(t).x(), Eigen::Vector3d::UnitX());
}
inline double Rpm(int motor, double t) {
  return 6000.0 + 500.0 * motor + 300.0 * std::sin(3.0 * t);
}

/// A vector of NED in east, north, up.
inline Eigen::Vector3d Enu(const Eigen::Vector3d& ned) { return {ned.y(), ned.x(), -ned.z()}; }

/// How far an attitude is from the made-up flight's: the largest error of the nose, the left wing
/// and the top, each seen from the ground.
inline double AttitudeError(const Eigen::Quaterniond& q_EnuFlu, double t) {
  const Eigen::Matrix3d R_NedFrd = AttitudeNed(t).toRotationMatrix(), R = q_EnuFlu.matrix();
  return std::max({(R.col(0) - Enu(R_NedFrd.col(0))).norm(),
                   (R.col(1) + Enu(R_NedFrd.col(1))).norm(),
                   (R.col(2) + Enu(R_NedFrd.col(2))).norm()});
}

}  // namespace odmc::testing_support
