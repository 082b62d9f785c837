#pragma once

#include <ceres/manifold.h>

#include <Eigen/Core>

namespace odmc {

/// Unit quaternion (x, y, z, w) with the right perturbation q Exp(theta), theta the full rotation
/// vector in the body frame [rad]. Ceres' own EigenQuaternionManifold turns on the left by twice
/// the vector; Jacobians for one are wrong for the other.                        model.md section 7
class RotationManifold final : public ceres::Manifold {
 public:
  int AmbientSize() const override { return 4; }
  int TangentSize() const override { return 3; }
  bool Plus(const double* x, const double* delta, double* x_plus_delta) const override;
  bool PlusJacobian(const double* x, double* jacobian) const override;
  bool Minus(const double* y, const double* x, double* y_minus_x) const override;
  bool MinusJacobian(const double* x, double* jacobian) const override;

  /// Minus Jacobian at `x` (3×4): takes a minimal Jacobian to the ambient one Ceres wants.
  static Eigen::Matrix<double, 3, 4> Lift(const double* x);
};

/// A keyframe's state (13) with tangent (p, theta, v, w) (12); see state.h.
class StateManifold final : public ceres::Manifold {
 public:
  int AmbientSize() const override { return 13; }
  int TangentSize() const override { return 12; }
  bool Plus(const double* x, const double* delta, double* x_plus_delta) const override;
  bool PlusJacobian(const double* x, double* jacobian) const override;
  bool Minus(const double* y, const double* x, double* y_minus_x) const override;
  bool MinusJacobian(const double* x, double* jacobian) const override;

  /// Minimal Jacobian (rows×12) lifted to the ambient one (rows×13).
  template <typename Derived>
  static Eigen::Matrix<double, Derived::RowsAtCompileTime, 13> Lift(
      const Eigen::MatrixBase<Derived>& minimal, const double* x) {
    Eigen::Matrix<double, Derived::RowsAtCompileTime, 13> ambient(minimal.rows(), 13);
    ambient.template leftCols<3>() = minimal.template leftCols<3>();
    ambient.template middleCols<4>(3).noalias() =
        minimal.template middleCols<3>(3) * RotationManifold::Lift(x + 3);
    ambient.template rightCols<6>() = minimal.template rightCols<6>();
    return ambient;
  }
};

/// Copies a minimal or ambient Jacobian to Ceres' row-major array; nothing where Ceres passes null.
template <typename Derived>
void WriteJacobian(const Eigen::MatrixBase<Derived>& jacobian, double* out) {
  if (out == nullptr) return;
  Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>(
      out, jacobian.rows(), jacobian.cols()) = jacobian;
}

}  // namespace odmc
