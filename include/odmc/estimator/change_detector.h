#pragma once

#include <Eigen/Core>

namespace odmc {

/// Sees that the vehicle has become another one: a load was picked up, a propeller broke. Then the
/// mean of what the model leaves unexplained moves away from zero, by far more than it ever did.
/// Watches the residual's running mean (kMean_s) against the size it had over the last kMemory_s;
/// what gusts and a poor model leave is part of that size. Thread-compatible.
class ChangeDetector {
 public:
  /// @param weight_N of the vehicle; @param inertia_kg_m2 about Bcm: they give the least size of a
  ///   change, kLeastShare of gravity or kLeastAngular
  ChangeDetector(double weight_N, const Eigen::Vector3d& inertia_kg_m2);

  /// @param dt length of the interval [s]
  /// @param force_B, torque_B what it leaves unexplained [N, N m]; torque zero where unknown
  /// @returns true once per change
  bool Add(double dt, const Eigen::Vector3d& force_B, const Eigen::Vector3d& torque_B);

  /// The vehicle landed, or the stream has a gap: the mean starts anew, the memory stays.
  void Break() { mean_.setZero(); }

  static constexpr double kMean_s = 0.15, kMemory_s = 10.0;
  static constexpr double kLearn_s = 4.0;       ///< before the first change and after each
  static constexpr double kSigmas = 6.0;        ///< of the running mean
  static constexpr double kLeastShare = 0.04;   ///< of gravity
  static constexpr double kLeastAngular = 2.0;  ///< [rad/s²]

 private:
  using Vector6 = Eigen::Matrix<double, 6, 1>;
  Vector6 least_;  // of a change, force and torque
  Vector6 mean_ = Vector6::Zero(), power_ = Vector6::Zero();
  double seen_s_ = 0.0;
};

}  // namespace odmc
