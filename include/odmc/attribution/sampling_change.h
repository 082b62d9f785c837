#pragma once

#include <optional>

#include "odmc/attribution/residual.h"

namespace odmc {

/// The same flight as if every second rotor speed were missing. Nothing where their stream is fast
/// (kSparseRotors_s), or so slow that twice the step is a hole.
/// @param log with what the filter takes from it
/// @param start_s time of its first odometry sample on the flight's clock
std::optional<ThinnedFlight> WithEverySecondRotorSample(const FlightLog& log,
                                                        const ThinnedFlight& flight,
                                                        double start_s = 0.0);

/// What becomes of a residual (N×6) with `halved` in the place of its flight.
ResidualModel::Wrenches ChangeBySampling(const ResidualModel& residual, const ThinnedFlight& halved,
                                         const DynamicModel& model, const ModelValues& values);

}  // namespace odmc
