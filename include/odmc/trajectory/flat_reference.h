#pragma once

#include <Eigen/Core>
#include <cmath>

namespace odmc {

/// Flat output of a quadrotor at one instant: where Bo shall be, and where it shall look.
struct FlatReference {
  Eigen::Vector3d p_WB = Eigen::Vector3d::Zero();  ///< [m]
  Eigen::Vector3d v_WB = Eigen::Vector3d::Zero();  ///< [m/s]
  Eigen::Vector3d a_WB = Eigen::Vector3d::Zero();  ///< [m/s²]
  Eigen::Vector3d j_WB = Eigen::Vector3d::Zero();  ///< [m/s³]
  Eigen::Vector3d s_WB = Eigen::Vector3d::Zero();  ///< [m/s⁴]
  double yaw = 0.0;       ///< turn about W z before the shortest tilt [rad]
  double d_yaw = 0.0;     ///< [rad/s]
  double dd_yaw = 0.0;    ///< [rad/s²]
  bool standing = false;  ///< on the ground: rotors idle, nothing to track
};

/// True if every number of it is finite.
inline bool IsFinite(const FlatReference& r) {
  return r.p_WB.allFinite() && r.v_WB.allFinite() && r.a_WB.allFinite() && r.j_WB.allFinite() &&
         r.s_WB.allFinite() && std::isfinite(r.yaw) && std::isfinite(r.d_yaw) &&
         std::isfinite(r.dd_yaw);
}

}  // namespace odmc
