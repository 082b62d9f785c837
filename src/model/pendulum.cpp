#include "odmc/model/pendulum.h"

#include <algorithm>
#include <cmath>

namespace odmc {
namespace {

constexpr double kLongestStep_s = 0.005;
constexpr double kWidestSwing = 0.9;  // the load stays below the vehicle

}  // namespace

Pendulum::Pendulum(double length_m, double damping_ratio, double gravity_m_s2, const Swing& swing)
    : length_(length_m), damping_(damping_ratio), gravity_(gravity_m_s2) {
  Eigen::Vector2d across = swing.head<2>();
  if (across.norm() > kWidestSwing) across *= kWidestSwing / across.norm();
  zeta_ << across, -std::sqrt(1.0 - across.squaredNorm());
  const Eigen::Vector2d rate = std::sqrt(gravity_ / length_) * swing.tail<2>();
  d_zeta_ << rate, -across.dot(rate) / zeta_.z();  // normal to zeta
}

void Pendulum::Advance(const Eigen::Vector3d& acceleration_W, double dt) {
  const int steps = std::max(1, static_cast<int>(std::ceil(dt / kLongestStep_s - 1e-9)));
  const double h = dt / steps;
  const double decay = 2.0 * damping_ * std::sqrt(gravity_ / length_);
  const Eigen::Vector3d drive = (acceleration_W + gravity_ * Eigen::Vector3d::UnitZ()) / length_;
  for (int i = 0; i < steps; ++i) {
    const Eigen::Vector3d across = drive - zeta_.dot(drive) * zeta_;
    d_zeta_ -= h * (across + decay * d_zeta_);
    zeta_ = (zeta_ + h * d_zeta_).normalized();
    d_zeta_ -= zeta_.dot(d_zeta_) * zeta_;  // the normalisation is the centripetal term
  }
}

Eigen::Vector3d Pendulum::Pull(const Eigen::Vector3d& acceleration_W) const {
  const double tension = length_ * d_zeta_.squaredNorm() -
                         zeta_.dot(acceleration_W + gravity_ * Eigen::Vector3d::UnitZ());
  return std::max(0.0, tension) * zeta_;
}

}  // namespace odmc
