#include "odmc/math/so3.h"

#include <cmath>

namespace odmc {
namespace {

constexpr double kSmallAngle = 1e-4;  // below it the series of model.md section 1 are exact

}  // namespace

Eigen::Quaterniond Exp(const Eigen::Vector3d& rotation_vector) {
  const double angle = rotation_vector.norm();
  const double half = 0.5 * angle;
  const double k = angle < kSmallAngle ? 0.5 - angle * angle / 48.0 : std::sin(half) / angle;
  return Eigen::Quaterniond(std::cos(half), k * rotation_vector.x(), k * rotation_vector.y(),
                            k * rotation_vector.z());
}

Eigen::Vector3d Log(const Eigen::Quaterniond& q) {
  const double sign = q.w() < 0.0 ? -1.0 : 1.0;
  const double n = q.vec().norm();
  const double w = sign * q.w();
  const double k = n < 1e-9 ? 2.0 / w : 2.0 * std::atan2(n, w) / n;
  return sign * k * q.vec();
}

Eigen::Matrix3d RightJacobian(const Eigen::Vector3d& a) {
  const double angle = a.norm();
  const Eigen::Matrix3d A = Hat(a);
  double c1 = 0.5, c2 = 1.0 / 6.0;
  if (angle >= kSmallAngle) {
    c1 = (1.0 - std::cos(angle)) / (angle * angle);
    c2 = (angle - std::sin(angle)) / (angle * angle * angle);
  }
  return Eigen::Matrix3d::Identity() - c1 * A + c2 * A * A;
}

Eigen::Matrix3d RightJacobianInverse(const Eigen::Vector3d& a) {
  const double angle = a.norm();
  const Eigen::Matrix3d A = Hat(a);
  double c = 1.0 / 12.0;
  if (angle >= kSmallAngle) {
    const double half = 0.5 * angle;
    c = (1.0 - half * std::cos(half) / std::sin(half)) / (angle * angle);
  }
  return Eigen::Matrix3d::Identity() + 0.5 * A + c * A * A;
}

}  // namespace odmc
