#include "odmc/estimator/residual_level.h"

#include <algorithm>
#include <cmath>

#include "odmc/factors/dynamics_factor.h"

namespace odmc {

void ResidualLevel::Fill(const Window& window, Snapshot* snapshot) {
  const auto& keyframes = window.keyframes();
  if (keyframes.size() < 2) return;
  keyframes[keyframes.size() - 2].ForEach<DynamicsFactor>(
      [&](const Factor& factor, const DynamicsFactor& dynamics) {
        Eigen::Matrix<double, kNumDynamicsRows, 1> e;
        if (!dynamics.UnwhitenedResidual(window.Blocks(factor, false).data(), &e)) return;
        const double dt = dynamics.measurement().dt;
        snapshot->residual_force_B = e.segment<3>(kRowVelocity) / dt;
        if (with_torque_) {
          snapshot->residual_torque_B = snapshot->body.I_BBcm_B * e.segment<3>(kRowAngular) / dt;
        }
        const double gain = std::min(1.0, dt / memory_s_);
        force_power_ += gain * (snapshot->residual_force_B.squaredNorm() / 3.0 - force_power_);
        torque_power_ += gain * (snapshot->residual_torque_B.squaredNorm() / 3.0 - torque_power_);
      });
  snapshot->residual_force_rms_N = std::sqrt(force_power_);
  snapshot->residual_torque_rms_Nm = std::sqrt(torque_power_);
}

}  // namespace odmc
