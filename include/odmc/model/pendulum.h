#pragma once

#include <Eigen/Core>

namespace odmc {

/// How a pendulum swings at one instant, in W: horizontal part of ζ, then that of dζ/dt / √(g/l)
/// [1]. Small and free, it swings with these amplitudes in radians (cosine, sine).
using Swing = Eigen::Vector4d;

/// How a load hangs on its cable at one instant, and how that depends on how it swung at the start
/// of the recording. Hanging still by default.
struct LoadPull {
  Eigen::Vector3d cable_W = Eigen::Vector3d(0.0, 0.0, -1.0);  ///< ζ, to the load
  /// Pull per unit of load where the vehicle's centre of mass falls freely [m/s²]:
  /// l |dζ/dt|² - ζ·(a_P - a_Bcm), P the point where the cable is fixed.
  double own_m_s2 = 0.0;
  Swing swing = Swing::Zero();                        ///< at the start, to hang like that
  Eigen::Matrix4d d_swing = Eigen::Matrix4d::Zero();  ///< rows cable_W, own_m_s2

  /// To first order, for another swing at the start.
  LoadPull For(const Swing& other) const;
};

/// A load on a taut, massless cable of length l below a moving point: unit vector ζ from the point
/// to the load, in W.                                                  model.md 12.17
///
///   l d²ζ/dt² = -(1 - ζ ζᵀ)(a + g e3) - l |dζ/dt|² ζ - 2 l δ √(g/l) dζ/dt
///
/// with a the point's acceleration and δ a damping ratio. Shared by simulator, estimator and
/// attribution. What the cable pulls with is the effect's to say (suspended_load).
class Pendulum {
 public:
  /// @param length_m, gravity_m_s2 > 0; damping_ratio >= 0
  /// @param swing to start with; hanging still by default
  Pendulum(double length_m, double damping_ratio, double gravity_m_s2,
           const Swing& swing = Swing::Zero());

  /// Moves on by `dt` under a constant acceleration of the point, in W [m/s²].
  void Advance(const Eigen::Vector3d& acceleration_W, double dt);

  /// Pull on the point per unit of load [m/s²], l |dζ/dt|² - ζ·acceleration; below zero where the
  /// cable would have to push.
  /// @param acceleration_W of the point against free fall, in W [m/s²]
  double Tension(const Eigen::Vector3d& acceleration_W) const;

  const Eigen::Vector3d& direction_W() const { return zeta_; }
  double length_m() const { return length_; }

 private:
  double length_, damping_, gravity_;
  Eigen::Vector3d zeta_, d_zeta_;
};

}  // namespace odmc
