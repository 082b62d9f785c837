#pragma once

#include <functional>

#include "odmc/math/gaussian.h"
#include "odmc/model/body_wrench.h"
#include "odmc/model/dynamic_model.h"
#include "odmc/sim/rigid_body.h"

namespace odmc {

/// Force and torque about Bcm, in B, that no model knows, at one flight state; empty: none.
using Unmodelled = std::function<BodyWrench(const FlightState&)>;

/// What no model knows: white force and torque about Bcm, along body axes, held over 10 ms.
class Disturbance {
 public:
  /// @param force_N, torque_Nm standard deviations of the 10 ms means for the vehicle of model.md
  ///   section 8; for `vehicle` the force scales with weight and the torque with weight times arm
  Disturbance(const Vehicle& vehicle, double force_N, double torque_Nm, int seed);

  /// Wrench from `time_s` on; to be asked in the order of time.
  const BodyWrench& At(double time_s);

 private:
  Gaussian random_;
  double force_, torque_;
  long period_ = -1;
  BodyWrench wrench_;
};

/// Parameters that vary in flight, as first-order Gauss-Markov processes, and the body that varies
/// with them and with time; renewed every 10 ms. `model` must outlive it.
class VaryingParameters {
 public:
  VaryingParameters(const DynamicModel& model, const ModelValues& values, int seed);

  /// Brings `body` to `time_s`; to be asked in the order of time.
  void Apply(double time_s, RigidBody* body);

 private:
  const DynamicModel* model_;
  ModelValues values_;
  Gaussian random_;
  long period_ = -1;
};

}  // namespace odmc
