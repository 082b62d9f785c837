#pragma once

#include <Eigen/Core>

namespace odmc {

/// Force and torque about Bcm, both in B.
struct BodyWrench {
  Eigen::Vector3d f_B = Eigen::Vector3d::Zero();        ///< [N]
  Eigen::Vector3d tau_Bcm_B = Eigen::Vector3d::Zero();  ///< [N m]
};

}  // namespace odmc
