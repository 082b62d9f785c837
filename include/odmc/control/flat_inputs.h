#pragma once

#include <Eigen/Core>

#include "odmc/control/allocation.h"
#include "odmc/control/control_model.h"
#include "odmc/trajectory/flat_reference.h"
#include "odmc/trajectory/flatness.h"

namespace odmc {

/// What a flat output asks of a vehicle with air around it.
struct FlatInputs {
  FlatAttitude attitude;
  double thrust_N = 0.0;                                ///< of the rotors, along body z
  Eigen::Vector3d tau_Bcm_B = Eigen::Vector3d::Zero();  ///< of the rotors [N m]
  RotorVector rotor_speed;                              ///< n×1 [rad/s]
};

/// The reference less what the air does along it: acceleration, jerk and snap that are left to
/// rotors and gravity. Differences of 10 ms give the derivatives of the air's force.
FlatReference ReferenceWithoutAir(const ControlModel& model, const FlatReference& reference);

/// Differential flatness with the model's own effects: fed open-loop to a vehicle that is on the
/// reference and has this model, the rotor speeds keep it there.        model.md section 11
/// @param reference of Bo, not standing, with a - g well away from zero
FlatInputs FlatInputsOf(const ControlModel& model, const Allocation& allocation,
                        const FlatReference& reference);

}  // namespace odmc
