#include "odmc/estimator/change_detector.h"

#include <algorithm>

namespace odmc {
namespace {

// A large mean counts as this many times the usual power at most, so that what is to be found does
// not become the measure of itself.
constexpr double kClip = 9.0;

}  // namespace

ChangeDetector::ChangeDetector(double weight_N, const Eigen::Vector3d& inertia_kg_m2) {
  least_ << Eigen::Vector3d::Constant(kLeastShare * weight_N), kLeastAngular * inertia_kg_m2;
}

bool ChangeDetector::Add(double dt, const Eigen::Vector3d& force_B,
                         const Eigen::Vector3d& torque_B) {
  Vector6 residual;
  residual << force_B, torque_B;
  mean_ += std::min(1.0, dt / kMean_s) * (residual - mean_);
  seen_s_ += dt;
  const Vector6 square = mean_.cwiseAbs2();
  const bool learning = seen_s_ < kLearn_s;
  if (!learning) {
    const Vector6 limit = (kSigmas * kSigmas * power_).cwiseMax(least_.cwiseAbs2());
    if ((square.array() > limit.array()).any()) {
      seen_s_ = 0.0;
      mean_.setZero();
      return true;
    }
  }
  // While learning, a plain average; then an exponential one.
  const double gain = std::min(1.0, dt / std::min(seen_s_, kMemory_s));
  const Vector6 clipped = learning ? square : square.cwiseMin(kClip * power_);
  power_ += gain * (clipped - power_);
  return false;
}

}  // namespace odmc
