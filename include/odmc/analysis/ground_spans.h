#pragma once

#include <vector>

#include "odmc/model/dynamic_model.h"
#include "odmc/phases/flight_phase.h"
#include "odmc/phases/phase_detector.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// Where a recording is not in free flight.
struct GroundSpans {
  StampSpans spans;  ///< first and last keyframe of each
  double on_ground_s = 0.0;
  long airborne_keyframes = 0;
};

/// Finds the ground phases as the estimator does, keyframe by keyframe, with the model fixed.
/// @param keyframe_rate_hz at most this many keyframes a second
GroundSpans FindGroundSpans(const FlightLog& log, const DynamicModel& model,
                            const ModelValues& values, const PhaseOptions& options = {},
                            double keyframe_rate_hz = 100.0);

}  // namespace odmc
