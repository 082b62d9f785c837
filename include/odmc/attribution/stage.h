#pragma once

#include <map>
#include <string>
#include <vector>

#include "odmc/attribution/candidates.h"
#include "odmc/attribution/residual.h"

namespace odmc {

/// A model with the values about which it is looked at.
struct Stage {
  Vehicle vehicle;
  std::map<std::string, double> values;  ///< by full name
};

/// The vehicle with a candidate added, what it was tried with frozen.
Vehicle With(const Vehicle& vehicle, const Candidate& candidate);

/// A model as the online estimator found it, inertia as the vehicle file has it: online it takes the
/// noise of the rotor speeds, and what else acts, for its own.
Stage StageOf(const DynamicModel& model, const ModelValues& values);

/// The model's initial values, but what is known.
ModelValues ValuesOf(const DynamicModel& model, const std::map<std::string, double>& known);

}  // namespace odmc
