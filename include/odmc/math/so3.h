#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace odmc {

/// Skew matrix [a]× (3×3) with [a]× x = a × x.
inline Eigen::Matrix3d Hat(const Eigen::Vector3d& a) {
  Eigen::Matrix3d m;
  m << 0.0, -a.z(), a.y(), a.z(), 0.0, -a.x(), -a.y(), a.x(), 0.0;
  return m;
}

/// Takes X [a]× (N×3) off `result`, for X (N×3): every row crossed with `a`, without the matrix.
template <typename Derived, typename Result>
void SubtractTimesHat(const Eigen::MatrixBase<Derived>& X, const Eigen::Vector3d& a,
                      Result* result) {
  static_assert(Derived::RowsAtCompileTime > 0 && Derived::ColsAtCompileTime == 3, "N×3");
  result->col(0) += X.col(2) * a.y() - X.col(1) * a.z();
  result->col(1) += X.col(0) * a.z() - X.col(2) * a.x();
  result->col(2) += X.col(1) * a.x() - X.col(0) * a.y();
}

/// X [a]× (N×3) for X (N×3).
template <typename Derived>
Eigen::Matrix<double, Derived::RowsAtCompileTime, 3> TimesHat(const Eigen::MatrixBase<Derived>& X,
                                                              const Eigen::Vector3d& a) {
  Eigen::Matrix<double, Derived::RowsAtCompileTime, 3> result;
  result.col(0) = X.col(1) * a.z() - X.col(2) * a.y();
  result.col(1) = X.col(2) * a.x() - X.col(0) * a.z();
  result.col(2) = X.col(0) * a.y() - X.col(1) * a.x();
  return result;
}

/// [a]× X (3×N) for X (3×N): `a` crossed with every column.
template <typename Derived>
Eigen::Matrix<double, 3, Derived::ColsAtCompileTime> HatTimes(const Eigen::Vector3d& a,
                                                              const Eigen::MatrixBase<Derived>& X) {
  static_assert(Derived::RowsAtCompileTime == 3 && Derived::ColsAtCompileTime > 0, "3×N");
  Eigen::Matrix<double, 3, Derived::ColsAtCompileTime> result;
  for (int i = 0; i < Derived::ColsAtCompileTime; ++i) result.col(i) = a.cross(X.col(i));
  return result;
}

/// Unit quaternion of a rotation vector (3×1) [rad].
Eigen::Quaterniond Exp(const Eigen::Vector3d& rotation_vector);

/// The same, with RightJacobian() there, at little more than the price of one.
Eigen::Quaterniond Exp(const Eigen::Vector3d& rotation_vector, Eigen::Matrix3d* right_jacobian);

/// Rotation vector (3×1) [rad] of a unit quaternion; norm at most pi.
Eigen::Vector3d Log(const Eigen::Quaterniond& q);

/// The same, with RightJacobianInverse() there, at little more than the price of one.
Eigen::Vector3d Log(const Eigen::Quaterniond& q, Eigen::Matrix3d* right_jacobian_inverse);

/// Right Jacobian of SO(3) (3×3): Exp(a + J_r(a) d) ≈ Exp(a) Exp(d) inverted, that is
/// Exp(a + d) ≈ Exp(a) Exp(J_r(a) d).                                   model.md section 1
Eigen::Matrix3d RightJacobian(const Eigen::Vector3d& a);

/// Inverse of RightJacobian() (3×3): Log(Exp(a) Exp(d)) ≈ a + J_r⁻¹(a) d.
Eigen::Matrix3d RightJacobianInverse(const Eigen::Vector3d& a);

/// Left Jacobian, J_l(a) = J_r(-a).
inline Eigen::Matrix3d LeftJacobian(const Eigen::Vector3d& a) { return RightJacobian(-a); }

/// Inverse of LeftJacobian().
inline Eigen::Matrix3d LeftJacobianInverse(const Eigen::Vector3d& a) {
  return RightJacobianInverse(-a);
}

}  // namespace odmc
