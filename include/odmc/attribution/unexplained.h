#pragma once

#include <string>
#include <vector>

#include "odmc/analysis/replay.h"
#include "odmc/attribution/attribution_options.h"
#include "odmc/attribution/residual.h"
#include "odmc/attribution/structure.h"

namespace odmc {

/// Where most of a residual is, in words: its channel with the surest structure, at which
/// frequency, in which block, and the quantity it lines up best with. Empty without a channel.
/// @param structure of the channels of `residual`
std::string WhereStructured(const std::vector<ChannelStructure>& structure,
                            const ThinnedFlight& flight, const ResidualModel::Wrenches& residual,
                            const AttributionOptions& options);

/// "a force of 0.36 of the weight acts from 2.81 to 3.74 s ...": the first contact between two
/// stretches of flight, at which attribution does not look; empty without one.
/// @param zero stamp of the recording's first sample
std::string PushInFlight(const ReplayResult& replay, Stamp zero);

}  // namespace odmc
