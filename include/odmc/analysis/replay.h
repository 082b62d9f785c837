#pragma once

#include <functional>
#include <utility>
#include <vector>

#include "odmc/analysis/history.h"
#include "odmc/estimator/estimator.h"
#include "odmc/phases/flight_phase.h"

namespace odmc {

/// What one pass of the estimator over a flight left behind.
struct ReplayResult {
  std::optional<Snapshot> last;                         ///< empty if the vehicle never flew
  EstimateHistory history;                              ///< one row per update
  std::vector<std::pair<double, UpdateTiming>> timing;  ///< flight time [s], every update
  std::vector<PhaseSpan> phases;                        ///< all of the recording, oldest first
  StampSpans ground_spans;                              ///< of these, what is not free flight
  std::vector<PhaseDetector::Seen> seen;                ///< ten a second, what tells the phases
  bool has_flown = false;         ///< the vehicle was seen to move by its own thrust
  double first_airborne_s = 0.0;  ///< flight time of the first update
  EstimatorCounters counters;
  SynchroniserCounters stream_counters;
};

/// Feeds a recorded flight to the estimator in the order of stamps, causally, as fast as it goes.
/// @param progress called with the share done (0 to 1), may be empty
/// @param give_up asked now and then: true ends it there, as if the recording did; may be empty
ReplayResult Replay(const FlightLog& log, Estimator* estimator,
                    const std::function<void(double)>& progress = {},
                    const std::function<bool()>& give_up = {});

/// Cuts every stream to [start_s, end_s] after the first odometry sample; end_s <= 0: no end.
void CutFlight(double start_s, double end_s, FlightLog* log);

}  // namespace odmc
