#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "odmc/sim/rigid_body.h"
#include "odmc/sim/trajectory.h"

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

/// Pilot of the simulator: geometric tracking on SE(3) with feedforward from the flat output, gains
/// in accelerations so that vehicles of any size fly alike. It knows the true model: it takes the
/// rotors' share of the wrench from the model itself and makes up for all else (drag, torques of
/// the air), so that flights reach their stated speed and tilt.
/// Thread-compatible; `body` must outlive it.
class TrackingController {
 public:
  explicit TrackingController(const RigidBody& body);

  /// Speeds to command for one control period (n×1, rad/s).
  /// @param state as measured, noise included
  RotorVector Command(double time_s, const RigidBodyState& state,
                      const FlatReference& reference) const;

  /// Speeds that balance the vehicle at rest (n×1, rad/s).
  RotorVector HoverSpeeds() const;

 private:
  using Rows = Eigen::Matrix<double, 4, 1>;  // f_z, tau_x, tau_y, tau_z
  using Map = Eigen::Matrix<double, 4, Eigen::Dynamic, 0, 4, kMaxRotors>;
  using InverseMap = Eigen::Matrix<double, Eigen::Dynamic, 4, 0, kMaxRotors, 4>;

  // Force and torque of the model at `state` that no steady rotor makes.
  BodyWrench AirWrench(double time_s, const RigidBodyState& state) const;
  // Force f_z and torque the rotors shall make.
  Rows DesiredRotorWrench(const RigidBodyState& state, const FlatReference& reference,
                          const BodyWrench& air) const;
  // Squared speeds within limits that make `wrench`; gives up yaw first.
  RotorVector Allocate(const Rows& wrench) const;

  const RigidBody* body_;
  Map map_;                           // of squared speeds to wrench
  InverseMap inverse_;                // pseudo-inverse of map_
  double min_squared_, max_squared_;  // limits of the squared speed [rad²/s²]
};

}  // namespace odmc
