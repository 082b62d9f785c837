#pragma once

#include <cstdint>
#include <functional>
#include <optional>

#include "odmc/estimator/noise_estimation.h"
#include "odmc/estimator/residual_level.h"
#include "odmc/window/window.h"

namespace odmc {

/// Follows the size of what the model leaves unexplained, and weighs the factors by it.
/// Thread-compatible.
class ModelNoise {
 public:
  /// @param accelerometer_m_s2 noise of the sensor itself, a keyframe's mean
  /// @param level_memory_s of the running size of the residuals in a snapshot
  ModelNoise(const Vehicle& vehicle, double floor_scale, double accelerometer_m_s2,
             double level_memory_s, bool with_torque);

  const ProcessNoiseEstimator& estimator() const { return estimator_; }
  bool with_torque() const { return with_torque_; }
  /// Goes on with the sizes that another one has found.
  void CarryOn(const ModelNoise& before) {
    estimator_ = before.estimator_;
    level_.CarryOn(before.level_);
  }

  /// Of the mean specific force over an interval [m/s²], where a force of `force_N` is not
  /// modelled.
  Eigen::Vector3d AccelerometerSigma(const Eigen::Vector3d& force_N) const;

  /// Fills what the newest interval leaves unexplained, and its running size. @pre the snapshot's
  /// body is set
  void FillResiduals(const Window& window, Snapshot* snapshot) { level_.Fill(window, snapshot); }

  /// Looks at what the newest settled intervals leave unexplained.
  /// @param settled_s their least age
  void Follow(const Window& window, double settled_s);
  /// Keyframes after `newest` were taken back.
  void TakeBack(std::int64_t newest);

  /// Brings the sizes in use to what was seen. @returns by how much the information of all forces
  ///   and torques changes, if it does; the factors are then to be weighed, see Weigh()
  std::optional<ProcessNoiseEstimator::Change> Step(const Window& window);
  /// Gives a keyframe's factors the sizes in use.
  void Weigh(Keyframe* keyframe);

  /// Runs `use` while all keyframes have the sizes before the last Step(): those that a solver
  /// which takes its time with new weights still works with.
  void WithSizesBefore(Window* window, const std::function<void()>& use) const;

 private:
  void Set(const ProcessNoiseEstimator& sizes, Keyframe* keyframe) const;

  double mass_kg_, accelerometer_m_s2_;
  bool with_torque_;
  ProcessNoiseEstimator estimator_;
  ResidualLevel level_;
  std::int64_t seen_ = -1;  // newest keyframe whose interval it was given
  struct SizeStep {
    ProcessNoiseEstimator before;
    std::int64_t newest = -1;   // keyframe before it
    std::int64_t reached = -1;  // newest of those that has the new sizes by now
  };
  std::optional<SizeStep> step_;  // the last one
};

}  // namespace odmc
