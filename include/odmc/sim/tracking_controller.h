#pragma once

#include <Eigen/Core>

#include "odmc/model/rotor_map.h"
#include "odmc/sim/rigid_body.h"
#include "odmc/trajectory/flat_reference.h"

namespace odmc {

/// Pilot of the simulator: geometric tracking on SE(3) with feedforward from the flat output, gains
/// in accelerations so that vehicles of any size fly alike. It knows the true model: it takes the
/// rotors' share of the wrench from the model itself and makes up for all else (drag, torques of
/// the air), so that flights reach their stated speed and tilt.
/// Thread-compatible; `body` must outlive it.
class TrackingController {
 public:
  /// @param bandwidth of both loops over the usual one: rate gains scale with it, stiffnesses with
  ///   its square
  explicit TrackingController(const RigidBody& body, double bandwidth = 1.0);

  /// Speeds to command for one control period (n×1, rad/s).
  /// @param state as measured, noise included
  RotorVector Command(double time_s, const RigidBodyState& state,
                      const FlatReference& reference) const;

  /// Speeds that balance the vehicle at rest (n×1, rad/s).
  RotorVector HoverSpeeds() const;

 private:
  using Rows = Eigen::Matrix<double, 4, 1>;  // f_z, tau_x, tau_y, tau_z
  using InverseMap = Eigen::Matrix<double, Eigen::Dynamic, 4, 0, kMaxRotors, 4>;

  // Force and torque of the model at `state` that no steady rotor makes.
  BodyWrench AirWrench(double time_s, const RigidBodyState& state) const;
  // Force f_z and torque the rotors shall make.
  Rows DesiredRotorWrench(const RigidBodyState& state, const FlatReference& reference,
                          const BodyWrench& air) const;
  // Squared speeds within limits that make `wrench`; gives up yaw first.
  RotorVector Allocate(const Rows& wrench) const;

  // Share of the yaw rate's gain that the rotors' reaction (model.md 12.7) leaves stable.
  double YawShare(double hover_speed) const;

  const RigidBody* body_;
  RotorMap map_;
  double bandwidth_;
  double yaw_share_ = 1.0;
  InverseMap inverse_;                // pseudo-inverse of map_
  double min_squared_, max_squared_;  // limits of the squared speed [rad²/s²]
};

}  // namespace odmc
