#include "odmc/estimator/load_observer.h"

#include <algorithm>

namespace odmc {
namespace {

// Differences of measured velocities are noisy. The swing integrates them and does not care; the
// tension takes the vehicle's acceleration as it is and gets it smoothed.
constexpr double kSmoothing_s = 0.05;

}  // namespace

LoadObserver::LoadObserver(const DynamicModel& model)
    : length_(model.IndexOf("suspended_load.length")),
      damping_(model.IndexOf("suspended_load.damping")),
      gravity_(model.vehicle().gravity_m_s2) {}

Eigen::Vector3d LoadObserver::Advance(const Eigen::Vector3d& v0_W, const Eigen::Vector3d& v1_W,
                                      double dt, const ModelValues& values) {
  if (length_ < 0) return Eigen::Vector3d(0.0, 0.0, -gravity_);
  const Eigen::Vector3d acceleration_W = (v1_W - v0_W) / dt;
  if (!pendulum_) {
    pendulum_.emplace(values[length_], values[damping_], gravity_);
    smooth_acceleration_W_.setZero();
  }
  smooth_acceleration_W_ +=
      std::min(1.0, dt / kSmoothing_s) * (acceleration_W - smooth_acceleration_W_);
  pendulum_->Advance(acceleration_W, 0.5 * dt);
  const Eigen::Vector3d pull_W = pendulum_->Pull(smooth_acceleration_W_);
  pendulum_->Advance(acceleration_W, 0.5 * dt);
  return pull_W;
}

}  // namespace odmc
