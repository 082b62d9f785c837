#pragma once

#include <Eigen/Core>

namespace odmc {

/// A load on a taut, massless cable of length l below a moving point: unit vector ζ from the point
/// to the load, in W.                                                  model.md 12.17
///
///   l d²ζ/dt² = -(1 - ζ ζᵀ)(a + g e3) - l |dζ/dt|² ζ - 2 l δ √(g/l) dζ/dt
///
/// with a the point's acceleration and δ a damping ratio. Shared by simulator, estimator and
/// attribution.
class Pendulum {
 public:
  /// @param length_m, gravity_m_s2 > 0; damping_ratio >= 0
  Pendulum(double length_m, double damping_ratio, double gravity_m_s2);

  /// Moves on by `dt` under a constant acceleration of the point, in W [m/s²].
  void Advance(const Eigen::Vector3d& acceleration_W, double dt);

  /// Pull on the point per unit of load, along the cable, in W [m/s²]; zero where the cable would
  /// have to push.
  Eigen::Vector3d Pull(const Eigen::Vector3d& acceleration_W) const;

  const Eigen::Vector3d& direction_W() const { return zeta_; }
  double length_m() const { return length_; }

 private:
  double length_, damping_, gravity_;
  Eigen::Vector3d zeta_ = -Eigen::Vector3d::UnitZ();
  Eigen::Vector3d d_zeta_ = Eigen::Vector3d::Zero();
};

}  // namespace odmc
