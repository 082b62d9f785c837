#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "odmc/model/dynamic_model.h"
#include "odmc/model/pendulum.h"

namespace odmc {

/// How the odometry sensor moves at one instant.
struct SensorMotion {
  Eigen::Vector3d v_WS = Eigen::Vector3d::Zero();      ///< in W [m/s]
  Eigen::Matrix3d R_WS = Eigen::Matrix3d::Identity();  ///< attitude
  Eigen::Vector3d w_S = Eigen::Vector3d::Zero();       ///< angular rate, in S [rad/s]
};

/// Follows a suspended load by driving a pendulum with the vehicle's measured motion, from the
/// swing that the model's values give it at the start of the recording. Does nothing for a model
/// without the effect suspended_load. The cable's length and damping are those of the first call.
/// `model` must outlive it.
class LoadObserver {
 public:
  /// A gap this long leaves nothing of the swing before it.
  static constexpr double kForgotten_s = 20.0;

  /// @param with_derivatives also find how the pull depends on the swing at the start
  LoadObserver(const DynamicModel& model, bool with_derivatives);

  /// Over an interval of `dt` [s] in which the sensor's motion went from `from` to `to`. The
  /// pendulum is driven by the point where the cable is fixed.
  /// @param body properties by `values`, where the caller has them
  /// @returns the cable's pull in the interval's middle
  LoadPull Advance(const SensorMotion& from, const SensorMotion& to, double dt,
                   const ModelValues& values, const BodyProperties* body = nullptr);

  /// A new recording: how the load swings is not known, and taken to be not at all.
  void Reset();

 private:
  void Start(const ModelValues& values);
  void AdvanceAll(const Eigen::Vector3d& acceleration_W, double dt);

  const DynamicModel* model_;
  std::optional<PendulumParameters> parameters_;  // in the model
  double gravity_;
  bool with_derivatives_;
  bool is_first_recording_ = true;
  Swing start_ = Swing::Zero();
  std::optional<Pendulum> pendulum_;
  std::vector<Pendulum> nearby_;  // started with a little more and a little less of each swing
  Eigen::Vector3d smooth_acceleration_W_ = Eigen::Vector3d::Zero();
};

}  // namespace odmc
