#include "odmc/preintegration/imu_interval.h"

#include <algorithm>

#include "odmc/math/so3.h"

namespace odmc {
namespace {

using Eigen::Vector3d;

Vector3d Interpolate(const Vector3d& a, const Vector3d& b, const ImuSample& first,
                     const ImuSample& second, Stamp stamp) {
  const double x =
      static_cast<double>(stamp - first.stamp) / static_cast<double>(second.stamp - first.stamp);
  return (1.0 - x) * a + x * b;
}

/// Adds one piece of constant rate `w` [rad/s] lasting `dt` [s].
void IntegrateGyro(const Vector3d& w, double dt, ImuInterval* interval) {
  const Vector3d turn = w * dt;
  const Eigen::Quaterniond step = Exp(turn);
  interval->d_bias =
      step.toRotationMatrix().transpose() * interval->d_bias - RightJacobian(turn) * dt;
  interval->delta_q = (interval->delta_q * step).normalized();
}

}  // namespace

std::optional<ImuInterval> PreintegrateImu(const Ring<ImuSample>& samples, Stamp from, Stamp to,
                                           const Eigen::Vector3d& gyro_bias, double max_hole_s) {
  const auto later = [](Stamp stamp, const ImuSample& s) { return stamp < s.stamp; };
  auto it = std::upper_bound(samples.begin(), samples.end(), from, later);
  if (it == samples.begin()) return std::nullopt;
  --it;
  ImuInterval interval;
  interval.dt = ToSeconds(to - from);
  interval.delta_q.setIdentity();
  interval.d_bias.setZero();
  interval.bias_lin = gyro_bias;
  interval.mean_specific_force.setZero();
  interval.has_gyro = interval.has_accelerometer = true;
  for (; it->stamp < to; ++it) {
    const auto next = it + 1;
    if (next == samples.end()) return std::nullopt;
    if (next->stamp <= it->stamp) return std::nullopt;
    if (ToSeconds(next->stamp - it->stamp) > max_hole_s) return std::nullopt;
    const Stamp a = std::max(it->stamp, from), b = std::min(next->stamp, to);
    const Stamp middle = a + (b - a) / 2;
    const double dt = ToSeconds(b - a);
    interval.has_gyro = interval.has_gyro && it->gyro_I && next->gyro_I;
    interval.has_accelerometer =
        interval.has_accelerometer && it->specific_force_I && next->specific_force_I;
    if (interval.has_gyro) {
      IntegrateGyro(Interpolate(*it->gyro_I, *next->gyro_I, *it, *next, middle) - gyro_bias, dt,
                    &interval);
      interval.gyro_at_end = Interpolate(*it->gyro_I, *next->gyro_I, *it, *next, b);
    }
    if (interval.has_accelerometer) {
      interval.mean_specific_force +=
          dt / interval.dt *
          Interpolate(*it->specific_force_I, *next->specific_force_I, *it, *next, middle);
    }
    ++interval.num_samples;
  }
  if (interval.num_samples == 0) return std::nullopt;
  return interval;
}

}  // namespace odmc
