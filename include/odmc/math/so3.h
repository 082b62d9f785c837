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

/// Unit quaternion of a rotation vector (3×1) [rad].
Eigen::Quaterniond Exp(const Eigen::Vector3d& rotation_vector);

/// Rotation vector (3×1) [rad] of a unit quaternion; norm at most pi.
Eigen::Vector3d Log(const Eigen::Quaterniond& q);

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
