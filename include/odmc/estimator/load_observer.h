#pragma once

#include <Eigen/Core>
#include <optional>

#include "odmc/model/dynamic_model.h"
#include "odmc/model/pendulum.h"

namespace odmc {

/// Follows a suspended load by driving a pendulum with the vehicle's measured motion. Does nothing
/// for a model without the effect suspended_load. The cable's length and damping are those of the
/// first call after a reset.
class LoadObserver {
 public:
  explicit LoadObserver(const DynamicModel& model);

  /// Over an interval of `dt` in which the velocity went from `v0_W` to `v1_W` [m/s].
  /// @returns the cable's pull per unit of load in its middle, in W [m/s²]
  Eigen::Vector3d Advance(const Eigen::Vector3d& v0_W, const Eigen::Vector3d& v1_W, double dt,
                          const ModelValues& values);

  /// The load hangs still again.
  void Reset() { pendulum_.reset(); }

 private:
  int length_, damping_;
  double gravity_;
  std::optional<Pendulum> pendulum_;
  Eigen::Vector3d smooth_acceleration_W_ = Eigen::Vector3d::Zero();
};

}  // namespace odmc
