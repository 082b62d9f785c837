#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "odmc/trajectory/flat_reference.h"

namespace odmc {

/// Attitude, rates and thrust that a flat output asks of a quadrotor without drag.
struct FlatAttitude {
  Eigen::Quaterniond q_WB = Eigen::Quaterniond::Identity();
  Eigen::Vector3d w_WB_B = Eigen::Vector3d::Zero();   ///< [rad/s]
  Eigen::Vector3d dw_WB_B = Eigen::Vector3d::Zero();  ///< [rad/s²]
  double specific_thrust = 0.0;                       ///< along body z [m/s²]
};

/// Differential flatness: a turn by yaw about W z, then the shortest tilt that takes body z along
/// a - g. Unlike a heading held in the horizontal plane this asks for no fast yaw at large tilt.
/// @param g_W gravity (3×1) in W [m/s²]; a - g must not vanish nor point straight down
FlatAttitude FlatAttitudeOf(const FlatReference& reference, const Eigen::Vector3d& g_W);

}  // namespace odmc
