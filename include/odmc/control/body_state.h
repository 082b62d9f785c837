#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "odmc/sensing/samples.h"

namespace odmc {

/// Where the body is and how it moves, as a controller takes it.
struct BodyState {
  Stamp stamp = 0;
  Eigen::Vector3d p_WB = Eigen::Vector3d::Zero();            ///< Bo in W [m]
  Eigen::Quaterniond q_WB = Eigen::Quaterniond::Identity();  ///< unit
  Eigen::Vector3d v_WB = Eigen::Vector3d::Zero();            ///< of Bo, in W [m/s]
  Eigen::Vector3d w_WB_B = Eigen::Vector3d::Zero();          ///< [rad/s]
};

}  // namespace odmc
