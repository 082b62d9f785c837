#pragma once

#include <string>
#include <vector>

#include "odmc/analysis/prediction.h"
#include "odmc/estimator/options.h"
#include "odmc/model/vehicle.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// Parameters that are learned on the flight that they predict, each sample from what was before
/// it; all others hold.
struct FollowedParameters {
  std::vector<std::string> names;  ///< "thrust.k_f"
  ValueVariation vary;             ///< empty: none
};

/// Parameters as the online estimator follows them on a flight, everything else held. At each time
/// the estimate is of 0.1 s before: it has seen nothing of what a sample there is filtered from.
/// @param vehicle with the parameters in it; their sigma is how far the flight may lie from them
/// @param names full names of parameters
/// @param options with k_f_walk_rate above 0 k_f, and k_m where it is estimated, follow too and
/// walk
/// @throws std::invalid_argument for a name that the vehicle's model lacks, or that it holds
FollowedParameters FollowFlight(const FlightLog& log, const Vehicle& vehicle,
                                const std::vector<std::string>& names,
                                const EstimatorOptions& options);

}  // namespace odmc
