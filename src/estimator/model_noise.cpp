#include "odmc/estimator/model_noise.h"

#include <algorithm>
#include <vector>

#include "odmc/factors/dynamics_factor.h"
#include "odmc/factors/imu_factors.h"

namespace odmc {

ModelNoise::ModelNoise(const Vehicle& vehicle, double floor_scale, double accelerometer_m_s2,
                       double level_memory_s, bool with_torque)
    : mass_kg_(vehicle.mass_kg),
      accelerometer_m_s2_(accelerometer_m_s2),
      with_torque_(with_torque),
      estimator_(vehicle.mass_kg * vehicle.gravity_m_s2, vehicle.ArmLength(), floor_scale),
      level_(level_memory_s, with_torque) {}

Eigen::Vector3d ModelNoise::AccelerometerSigma(const Eigen::Vector3d& force_N) const {
  const double sensor = accelerometer_m_s2_;
  return ((force_N / mass_kg_).array().square() + sensor * sensor).sqrt();
}

void ModelNoise::Follow(const Window& window, double settled_s) {
  const auto& keyframes = window.keyframes();
  const Stamp until = keyframes.back().stamp - FromSeconds(settled_s);
  for (std::int64_t id = std::max(seen_ + 1, keyframes.front().id);
       id < keyframes.back().id && window.keyframe(id).stamp <= until; ++id) {
    seen_ = id;
    window.keyframe(id).ForEach<DynamicsFactor>(
        [&](const Factor& factor, const DynamicsFactor& dynamics) {
          Eigen::Matrix<double, kNumDynamicsRows, 1> e;
          if (!dynamics.UnwhitenedResidual(window.Blocks(factor, false).data(), &e)) return;
          const DynamicsNoise& noise = dynamics.noise();
          IntervalResidual residual;
          residual.dt = dynamics.measurement().dt;
          residual.force_N = e.segment<3>(kRowVelocity) / residual.dt;
          residual.torque_Nm =
              noise.nominal_inertia.cwiseProduct(e.segment<3>(kRowAngular)) / residual.dt;
          residual.rotor_force_N.z() = noise.rotor_force_N;
          residual.rotor_torque_Nm = noise.rotor_torque_Nm;
          estimator_.Add(residual, with_torque_);
        });
  }
}

void ModelNoise::TakeBack(std::int64_t newest) {
  seen_ = std::min(seen_, newest);
  step_.reset();
}

std::optional<ProcessNoiseEstimator::Change> ModelNoise::Step(const Window& window) {
  const ProcessNoiseEstimator before = estimator_;
  const auto change = estimator_.Step();
  if (change) step_ = {before, window.keyframes().back().id, -1};
  return change;
}

void ModelNoise::Weigh(Keyframe* keyframe) {
  Set(estimator_, keyframe);
  for (Factor& factor : keyframe->factors) ++factor.revision;
  if (keyframe->id <= step_->newest) step_->reached = std::max(step_->reached, keyframe->id);
}

void ModelNoise::WithSizesBefore(Window* window, const std::function<void()>& use) const {
  std::vector<Keyframe*> weighed;
  for (Keyframe& keyframe : window->keyframes()) {
    if (step_ && keyframe.id <= step_->reached) weighed.push_back(&keyframe);
  }
  for (Keyframe* keyframe : weighed) Set(step_->before, keyframe);
  use();
  for (Keyframe* keyframe : weighed) Set(estimator_, keyframe);
}

void ModelNoise::Set(const ProcessNoiseEstimator& sizes, Keyframe* keyframe) const {
  keyframe->ForEach<DynamicsFactor>([&](Factor*, DynamicsFactor* dynamics) {
    const double dt = dynamics->measurement().dt;
    dynamics->SetModelNoise(sizes.ForceSigma(dt), sizes.TorqueSigma(dt));
  });
  keyframe->ForEach<AccelerometerFactor>([&](Factor*, AccelerometerFactor* accelerometer) {
    const double dt = accelerometer->measurement().dt;
    accelerometer->SetSigma(AccelerometerSigma(sizes.ForceSigma(dt)));
  });
}

}  // namespace odmc
