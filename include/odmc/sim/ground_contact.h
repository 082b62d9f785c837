#pragma once

#include <Eigen/Core>
#include <array>

#include "odmc/model/body_properties.h"
#include "odmc/model/body_wrench.h"
#include "odmc/sim/rigid_body.h"

namespace odmc {

/// How a vehicle stands.
struct GroundOptions {
  double leg_height_m = 0.05;    ///< feet below Bo, > 0
  double static_sink_m = 0.003;  ///< of the vehicle at rest, > 0
  double damping_ratio = 0.6;    ///< of its bounce, >= 0
  double friction = 0.8;         ///< Coulomb's coefficient, >= 0
};

/// A level plane under the vehicle: one foot below each rotor, and the hubs themselves for a
/// vehicle that lies on its back. Each point is pushed up by a spring and a damper, never pulled
/// down, and held sideways by another pair up to the limit of friction, where it slides: Coulomb's
/// law, regularised so that a standing vehicle stays where it is (Cundall and Strack 1979).
class GroundContact {
 public:
  /// Such that `body` rests level with Bo at z = 0; the feet are trimmed by part of the sink, as
  /// the centre of mass asks.
  GroundContact(const Vehicle& vehicle, const BodyProperties& body, const GroundOptions& options);

  /// Force and torque about the body's centre of mass; to be asked step by step.
  BodyWrench Push(const RigidBodyState& state, const Eigen::Vector3d& p_BBcm);

  /// Forgets where the points held on, for a vehicle that is put elsewhere.
  void LetGo();

  /// True if the last Push() was one.
  bool touches() const { return touches_; }

 private:
  struct Point {
    Eigen::Vector3d p_B = Eigen::Vector3d::Zero();
    bool down = false;                                   // below the plane
    Eigen::Vector2d anchor_W = Eigen::Vector2d::Zero();  // where it holds on
  };

  // Force in W on a point that is `depth` below the plane.
  Eigen::Vector3d ForceOn(const Eigen::Vector3d& p_W, const Eigen::Vector3d& v_W, double depth,
                          Point* point) const;

  std::array<Point, 2 * kMaxRotors> points_;
  int num_points_;
  double plane_z_, reach_;  // highest Bo that may touch: plane_z_ + reach_
  double stiffness_, damping_, friction_;
  bool touches_ = false;
};

}  // namespace odmc
