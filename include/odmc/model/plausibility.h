#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "odmc/model/dynamic_model.h"

namespace odmc {

/// Sentences about values that no vehicle can have: not a number, a wrong sign by more than one
/// sigma, an inertia that no body has or far from nominal, a centre of gravity outside the rotors,
/// gravity far off vertical. Estimator and controller both ask.
/// @param values, sigma num_parameters()×1 each; sigma 0 where frozen or unknown
std::vector<std::string> UnphysicalValues(const DynamicModel& model, const ModelValues& values,
                                          const Eigen::VectorXd& sigma);

/// What to say of a thrust coefficient that is more than three times, or less than a third of, what
/// it started from: then a unit or the mass is wrong, not the vehicle file by a little. Empty if
/// all is well.
std::string ThrustDoubt(const DynamicModel& model, const ModelValues& values);

}  // namespace odmc
