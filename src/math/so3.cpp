#include "odmc/math/so3.h"

#include <cmath>

namespace odmc {
namespace {

constexpr double kSmallAngle = 1e-4;  // below it the series of model.md section 1 are exact

/// Unit quaternion of `a`, by cosine and sine of half the angle |a|.
Eigen::Quaterniond UnitQuaternion(const Eigen::Vector3d& a, double angle, double cos_half,
                                  double sin_half) {
  const double k = angle < kSmallAngle ? 0.5 - angle * angle / 48.0 : sin_half / angle;
  return Eigen::Quaterniond(cos_half, k * a.x(), k * a.y(), k * a.z());
}

/// By cosine and sine of half the angle |a|.
Eigen::Matrix3d RightJacobian(const Eigen::Vector3d& a, double angle, double cos_half,
                              double sin_half) {
  double c1 = 0.5, c2 = 1.0 / 6.0;
  if (angle >= kSmallAngle) {
    c1 = 2.0 * sin_half * sin_half / (angle * angle);                    // 1 - cos
    c2 = (angle - 2.0 * sin_half * cos_half) / (angle * angle * angle);  // angle - sin
  }
  // 1 - c1 [a]× + c2 [a]×², with [a]×² = a aᵀ - |a|² 1.
  Eigen::Matrix3d J = c2 * a * a.transpose();
  J.diagonal().array() += 1.0 - c2 * angle * angle;
  return J - c1 * Hat(a);
}

/// Rotation vector of the quaternion (w, v) with n = |v|.
Eigen::Vector3d RotationVector(double w, const Eigen::Vector3d& v, double n) {
  const double sign = w < 0.0 ? -1.0 : 1.0;
  const double k = n < 1e-9 ? 2.0 / (sign * w) : 2.0 * std::atan2(n, sign * w) / n;
  return sign * k * v;
}

/// By cosine and sine (or any multiple of both) of half the angle |a|.
Eigen::Matrix3d RightJacobianInverse(const Eigen::Vector3d& a, double cos_half, double sin_half) {
  const double square = a.squaredNorm();
  double c = 1.0 / 12.0;
  if (square >= kSmallAngle * kSmallAngle) {
    c = (1.0 - 0.5 * std::sqrt(square) * cos_half / sin_half) / square;
  }
  // 1 + [a]×/2 + c [a]×², with [a]×² = a aᵀ - |a|² 1.
  Eigen::Matrix3d J = c * a * a.transpose();
  J.diagonal().array() += 1.0 - c * square;
  return J + 0.5 * Hat(a);
}

}  // namespace

Eigen::Quaterniond Exp(const Eigen::Vector3d& rotation_vector) {
  const double angle = rotation_vector.norm();
  return UnitQuaternion(rotation_vector, angle, std::cos(0.5 * angle), std::sin(0.5 * angle));
}

Eigen::Quaterniond Exp(const Eigen::Vector3d& rotation_vector, Eigen::Matrix3d* right_jacobian) {
  const double angle = rotation_vector.norm();
  const double cos_half = std::cos(0.5 * angle), sin_half = std::sin(0.5 * angle);
  *right_jacobian = RightJacobian(rotation_vector, angle, cos_half, sin_half);
  return UnitQuaternion(rotation_vector, angle, cos_half, sin_half);
}

Eigen::Vector3d Log(const Eigen::Quaterniond& q) {
  return RotationVector(q.w(), q.vec(), q.vec().norm());
}

Eigen::Vector3d Log(const Eigen::Quaterniond& q, Eigen::Matrix3d* right_jacobian_inverse) {
  const double n = q.vec().norm();
  const Eigen::Vector3d a = RotationVector(q.w(), q.vec(), n);
  *right_jacobian_inverse = RightJacobianInverse(a, std::abs(q.w()), n);
  return a;
}

Eigen::Matrix3d RightJacobian(const Eigen::Vector3d& a) {
  const double angle = a.norm();
  return RightJacobian(a, angle, std::cos(0.5 * angle), std::sin(0.5 * angle));
}

Eigen::Matrix3d RightJacobianInverse(const Eigen::Vector3d& a) {
  const double half = 0.5 * a.norm();
  return RightJacobianInverse(a, std::cos(half), std::sin(half));
}

}  // namespace odmc
