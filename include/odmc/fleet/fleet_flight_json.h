#pragma once

#include <string>

#include "odmc/fleet/joint_calibration.h"

namespace odmc {

/// A calibrated flight as JSON text (flight.json), every number with all its digits, and back: what
/// a fleet needs of it, so that no pass is made twice.
/// @throws std::invalid_argument with a sentence that names `file` and the key
std::string FormatFleetFlight(const FleetFlight& flight);
FleetFlight ParseFleetFlight(const std::string& text, const std::string& file);
FleetFlight LoadFleetFlight(const std::string& file);

}  // namespace odmc
