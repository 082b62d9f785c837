#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "odmc/model/body_wrench.h"
#include "odmc/sensing/samples.h"
#include "odmc/sim/rigid_body.h"

namespace odmc {

/// What really happened at one stamp. Where the rotors' command or the disturbance steps at the
/// stamp, accelerations and wrenches are those just after it.
struct TruthSample {
  Stamp stamp = 0;
  bool on_ground = false;
  Eigen::Vector3d p_WB = Eigen::Vector3d::Zero();  ///< Bo in W [m]
  Eigen::Quaterniond q_WB = Eigen::Quaterniond::Identity();
  Eigen::Vector3d v_WB = Eigen::Vector3d::Zero();     ///< of Bo, in W [m/s]
  Eigen::Vector3d w_WB_B = Eigen::Vector3d::Zero();   ///< [rad/s]
  Eigen::Vector3d dw_WB_B = Eigen::Vector3d::Zero();  ///< [rad/s²]
  RotorVector rotor_speed;                            ///< [rad/s]
  RotorVector rotor_speed_cmd;                        ///< [rad/s]
  /// All forces but gravity, and their torque about Bcm, in B: model, disturbance and ground.
  Eigen::Vector3d f_B = Eigen::Vector3d::Zero();        ///< [N]
  Eigen::Vector3d tau_Bcm_B = Eigen::Vector3d::Zero();  ///< [N m]
  /// The part of these that the model does not make.
  Eigen::Vector3d external_f_B = Eigen::Vector3d::Zero();        ///< [N]
  Eigen::Vector3d external_tau_Bcm_B = Eigen::Vector3d::Zero();  ///< [N m]
};

/// Truth of `body` in `state` under a command and an external wrench; says nothing of the ground.
TruthSample TruthOf(const RigidBody& body, Stamp stamp, const RigidBodyState& state,
                    const RotorVector& speed_cmd, const BodyWrench& external);

}  // namespace odmc
