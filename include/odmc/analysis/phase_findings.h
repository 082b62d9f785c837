#pragma once

#include <vector>

#include "odmc/analysis/replay.h"
#include "odmc/text/finding.h"

namespace odmc {

/// What the phases of a flight mean for the estimate: contacts in flight and hard landings that
/// were set aside, a vehicle that became another one, a vehicle that was never seen to fly.
/// @param zero stamp from which seconds count
std::vector<Finding> PhaseFindings(const ReplayResult& replay, bool learns_changes, Stamp zero);

/// A vehicle that became another one in flight, which the estimate did not follow at once.
Finding VehicleChanged(Stamp stamp, Stamp zero);

}  // namespace odmc
