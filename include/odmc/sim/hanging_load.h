#pragma once

#include <optional>

#include "odmc/model/body_wrench.h"
#include "odmc/model/pendulum.h"
#include "odmc/sim/rigid_body.h"

namespace odmc {

/// The load on a cable of a model that has one; nothing for other models. Knows
/// no ground.
class HangingLoad {
 public:
  HangingLoad(const DynamicModel& model, const ModelValues& values);

  /// Sets the pull on `state` and swings on by `step_s`.
  /// @param external wrench on the vehicle that the model does not make
  void Swing(const RigidBody& body, double time_s, const RotorVector& speed_cmd,
             const BodyWrench& external, double step_s, RigidBodyState* state);

 private:
  std::optional<Pendulum> pendulum_;
  Eigen::Vector3d p_BP_ = Eigen::Vector3d::Zero();  // where it hangs
};

}  // namespace odmc
