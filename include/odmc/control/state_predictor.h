#pragma once

#include <Eigen/Core>
#include <deque>
#include <optional>

#include "odmc/control/body_state.h"

namespace odmc {

/// What an inertial sensor at Bo along B would have measured over a short time.
struct InertialSample {
  Stamp stamp = 0;
  Eigen::Vector3d w_WB_B = Eigen::Vector3d::Zero();            ///< [rad/s]
  Eigen::Vector3d specific_force_B = Eigen::Vector3d::Zero();  ///< of Bo [m/s²]
};

/// Where the body is now, from odometry that arrives late and inertial samples that do not: each
/// odometry corrects the state at its own stamp, and the inertial samples since then carry it on.
/// Thread-compatible.
class StatePredictor {
 public:
  /// @param correction_s time constant with which odometry pulls the prediction, > 0 [s]
  explicit StatePredictor(double correction_s) : correction_s_(correction_s) {}

  /// Samples must come in order; those that do not are left out.
  void Add(const InertialSample& sample);

  /// @param measured state of the body at its stamp; stamps that do not advance are left out
  /// @returns false if it was more than kJump_m off the prediction: the source has jumped or this
  ///   vehicle was thrown; it is believed at once
  bool Correct(const BodyState& measured, const Eigen::Vector3d& g_W);

  /// State at `now`; nothing before the first odometry. Beyond the newest inertial sample the last
  /// one is held, for at most kHold_s.
  std::optional<BodyState> At(Stamp now, const Eigen::Vector3d& g_W) const;

  /// Stamp of the newest odometry; 0 before the first.
  Stamp newest_odometry() const { return anchor_ ? anchor_->stamp : 0; }

  void Reset();

  static constexpr double kJump_m = 0.5;
  static constexpr double kHold_s = 0.05;

 private:
  static BodyState Moved(const BodyState& state, const InertialSample& sample, double dt,
                         const Eigen::Vector3d& g_W);
  /// From `state` to the stamp `until`.
  BodyState Carried(BodyState state, Stamp until, const Eigen::Vector3d& g_W) const;

  double correction_s_;
  std::deque<InertialSample> inertial_;
  std::optional<BodyState> anchor_;  // at the newest odometry, corrected
};

}  // namespace odmc
