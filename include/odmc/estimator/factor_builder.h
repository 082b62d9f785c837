#pragma once

#include <ceres/loss_function.h>

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "odmc/estimator/front_end.h"
#include "odmc/estimator/learning_schedule.h"
#include "odmc/estimator/model_noise.h"
#include "odmc/estimator/options.h"
#include "odmc/factors/dynamics_factor.h"
#include "odmc/preintegration/rotor_rate_smoother.h"
#include "odmc/window/window.h"

namespace odmc {

/// Puts keyframes, biases and factors into the window. Thread-compatible.
class FactorBuilder {
 public:
  /// All must outlive the builder.
  FactorBuilder(const DynamicModel* model, const EstimatorOptions* options, bool with_torque,
                const ParameterLayout* layout, Window* window);

  /// Adds the newest keyframe with all that was measured there and since the one before.
  /// @param interval nothing: a chain of states starts here
  /// @param keyframes how many are in the window's flight, with this one
  void AddKeyframe(const OdometrySample& sample, const std::optional<KeyframeInterval>& interval,
                   const FrontEnd& front_end, const ModelNoise& model_noise, long keyframes,
                   LearningSchedule* schedule);

  /// The window was emptied: the next keyframe has a new bias.
  void ForgetBias() { bias_since_.reset(); }
  /// The newest keyframes were taken off.
  void TakeBack();
  /// The window is a new one.
  void Reset();
  void CarryOn(const FactorBuilder& before) { rotor_scale_sigma_ = before.rotor_scale_sigma_; }

  /// Of rotor speeds that come from a model, relative, mean over the flight; 0: none do.
  double rotor_scale_sigma() const { return rotor_scale_sigma_; }

 private:
  std::int64_t CurrentBias(Stamp stamp, bool has_imu);
  std::int64_t AddBias(bool is_first);
  void AddIntervalFactors(const KeyframeInterval& interval, std::int64_t id, Stamp start,
                          const ModelNoise& model_noise, double rotor_speed_noise,
                          LearningSchedule* schedule);
  void AddImuFactors(const ImuInterval& imu, const DynamicsMeasurement& measurement,
                     const Eigen::Vector3d& force_sigma_N, const ModelNoise& model_noise,
                     std::int64_t id);
  Eigen::Vector3d TorqueSeen(const KeyframeInterval& interval, const IntervalModel& k) const;
  DynamicsMeasurement MeasurementOf(const KeyframeInterval& interval, std::int64_t id,
                                    Stamp start) const;
  DynamicsNoise NoiseOf(const KeyframeInterval& interval, const ProcessNoiseEstimator& process,
                        double rotor_speed_noise) const;
  double RotorSpeedNoise(const FrontEnd& front_end) const;
  /// Adds a factor of the interval that ends at keyframe `id`.
  void AddToInterval(Factor factor, std::int64_t id, bool bias, bool parameters);
  void SeeRotorScale(const RotorInterval& rotors, long keyframes);
  void SmoothRotorRates(const KeyframeInterval& interval, std::int64_t id,
                        const FrontEnd& front_end);

  const DynamicModel* model_;
  const EstimatorOptions* options_;
  bool with_torque_;
  DynamicsForm form_;
  const ParameterLayout* layout_;
  Window* window_;
  std::unique_ptr<ceres::LossFunction> loss_;
  std::optional<Stamp> bias_since_;
  std::vector<Factor> pending_;  // of a bias whose first keyframe is about to come
  RotorRateSmoother rotor_rates_;
  double rotor_scale_sigma_ = 0.0;
};

}  // namespace odmc
