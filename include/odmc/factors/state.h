#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "odmc/sensing/samples.h"

namespace odmc {

/// Sizes of a keyframe's state block: (p_WS, q_WS as x y z w, v_WS, w_WS_S).
constexpr int kStateSize = 13;
constexpr int kStateTangentSize = 12;

/// First entry of each part in the tangent (p, theta, v, w) of a state.
enum StateTangent : int {
  kTangentPosition = 0,
  kTangentRotation = 3,
  kTangentVelocity = 6,
  kTangentRate = 9
};

/// Motion of the odometry's sensor frame S at one keyframe.
struct State {
  Eigen::Vector3d p_WS = Eigen::Vector3d::Zero();  ///< [m]
  Eigen::Quaterniond q_WS = Eigen::Quaterniond::Identity();
  Eigen::Vector3d v_WS = Eigen::Vector3d::Zero();    ///< in W [m/s]
  Eigen::Vector3d w_WS_S = Eigen::Vector3d::Zero();  ///< in S [rad/s]

  static State FromBlock(const double* block);
  void ToBlock(double* block) const;
};

}  // namespace odmc
