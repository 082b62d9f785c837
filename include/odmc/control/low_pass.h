#pragma once

#include <Eigen/Core>

namespace odmc {

/// Second-order low-pass of a vector (3×1) that gives its derivative beside it: x'' = wc² (u - x) -
/// 2 ζ wc x', ζ = 1/√2 (Butterworth). Takes any step; two filters of one cutoff have one phase,
/// which is what incremental inversion needs of angular acceleration and rotor torque.
class LowPass {
 public:
  /// @param cutoff_hz > 0
  explicit LowPass(double cutoff_hz);

  /// Moves on by `dt` (s, >= 0) with the input going straight from the last one to `input`. The
  /// first input is taken as having stood there for ever.
  void Add(const Eigen::Vector3d& input, double dt);

  /// Forgets everything.
  void Reset() { started_ = false; }

  const Eigen::Vector3d& value() const { return value_; }
  const Eigen::Vector3d& derivative() const { return derivative_; }  ///< [unit/s]

 private:
  double cutoff_rad_s_;
  bool started_ = false;
  Eigen::Vector3d input_ = Eigen::Vector3d::Zero();
  Eigen::Vector3d value_ = Eigen::Vector3d::Zero(), derivative_ = Eigen::Vector3d::Zero();
};

}  // namespace odmc
