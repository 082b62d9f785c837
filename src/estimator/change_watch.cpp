#include "odmc/estimator/change_watch.h"

#include "odmc/factors/dynamics_factor.h"

namespace odmc {
namespace {

constexpr double kDelay_s = 0.15;  // age of the intervals that show a change

}  // namespace

ChangeWatch::ChangeWatch(const Vehicle& vehicle)
    : detector_(vehicle.mass_kg * vehicle.gravity_m_s2, vehicle.inertia_kg_m2) {}

bool ChangeWatch::Look(const Window& window) {
  const Stamp until = window.keyframes().back().stamp - FromSeconds(kDelay_s);
  bool has_changed = false;
  for (const Keyframe& keyframe : window.keyframes()) {
    if (has_changed || keyframe.stamp > until) break;
    if (keyframe.stamp <= seen_) continue;
    seen_ = keyframe.stamp;
    keyframe.ForEach<DynamicsFactor>([&](const Factor& factor, const DynamicsFactor& dynamics) {
      Eigen::Matrix<double, kNumDynamicsRows, 1> e;
      if (!dynamics.UnwhitenedResidual(window.Blocks(factor, false).data(), &e)) return;
      const double dt = dynamics.measurement().dt;
      const Eigen::Vector3d torque =
          dynamics.noise().nominal_inertia.cwiseProduct(e.segment<3>(kRowAngular)) / dt;
      has_changed = detector_.Add(dt, e.segment<3>(kRowVelocity) / dt, torque) || has_changed;
    });
  }
  return has_changed;
}

}  // namespace odmc
