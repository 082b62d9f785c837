#pragma once

#include <string>
#include <vector>

#include "odmc/trajectory/minimum_snap.h"

namespace odmc {

/// A flight through waypoints and what it may ask of the vehicle.
struct WaypointFile {
  std::vector<Waypoint> waypoints;
  FlightLimits limits;
};

/// Reads a waypoint file (an example is config/waypoints/example.yaml).
/// @throws std::invalid_argument with a sentence that names file and key: unknown keys, wrong
///   types, NaN, limits out of range, fewer than two waypoints or one twice in a row
WaypointFile LoadWaypoints(const std::string& file);

/// The same from YAML text; `file` only names the source in errors.
WaypointFile ParseWaypoints(const std::string& text, const std::string& file);

}  // namespace odmc
