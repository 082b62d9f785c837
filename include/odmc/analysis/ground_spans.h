#pragma once

#include <utility>
#include <vector>

#include "odmc/estimator/gates.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// Where a flight stands on the ground.
struct GroundSpans {
  std::vector<std::pair<Stamp, Stamp>> spans;  ///< first and last keyframe of each stand
  double on_ground_s = 0.0;
  long airborne_keyframes = 0;
};

/// Finds the ground phases as the estimator does, keyframe by keyframe, with the model fixed.
/// @param keyframe_rate_hz at most this many keyframes a second
GroundSpans FindGroundSpans(const FlightLog& log, const DynamicModel& model,
                            const ModelValues& values, const GroundGateOptions& options = {},
                            double keyframe_rate_hz = 100.0);

}  // namespace odmc
