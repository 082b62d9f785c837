#pragma once

#include <Eigen/Core>

namespace odmc {

/// How a pendulum swings at one instant, in W: horizontal part of ζ, then that of dζ/dt / √(g/l)
/// [1]. Small and free, it swings with these amplitudes in radians (cosine, sine).
using Swing = Eigen::Vector4d;

/// Pull of a load's cable per unit of load, in W [m/s²], and how it depends on how the load swung
/// at the start of the recording.
struct LoadPull {
  Eigen::Vector3d pull_W = Eigen::Vector3d(0.0, 0.0, -9.81);  ///< hanging still by default
  Swing swing = Swing::Zero();                                ///< at the start, to get that pull
  Eigen::Matrix<double, 3, 4> d_swing = Eigen::Matrix<double, 3, 4>::Zero();

  /// To first order, for another swing at the start.
  Eigen::Vector3d For(const Swing& other) const { return pull_W + d_swing * (other - swing); }
};

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
  /// @param swing to start with; hanging still by default
  Pendulum(double length_m, double damping_ratio, double gravity_m_s2,
           const Swing& swing = Swing::Zero());

  /// Moves on by `dt` under a constant acceleration of the point, in W [m/s²].
  void Advance(const Eigen::Vector3d& acceleration_W, double dt);

  /// Pull on the point per unit of load, along the cable, in W [m/s²]; zero where the cable would
  /// have to push.
  Eigen::Vector3d Pull(const Eigen::Vector3d& acceleration_W) const;

  const Eigen::Vector3d& direction_W() const { return zeta_; }
  double length_m() const { return length_; }

 private:
  double length_, damping_, gravity_;
  Eigen::Vector3d zeta_, d_zeta_;
};

}  // namespace odmc
