#pragma once

#include <optional>
#include <vector>

#include "odmc/actuator/bench_run.h"

namespace odmc {

/// One coefficient of a thrust stand: force or torque = coefficient * sum of squared speeds +
/// offset.
struct StandFit {
  MeasuredValue coefficient;           ///< of one rotor [N s²] or [N m s²]
  std::vector<MeasuredValue> offsets;  ///< of the cell [N] or [N m], one per run; empty: not fitted
  double rmse = 0.0;                   ///< [N] or [N m], without outliers
  long rows = 0, outliers = 0;
};

/// Thrust coefficient: through the origin. A cell's offset is not fitted: at small Reynolds numbers
/// thrust falls faster than the squared speed, which an offset would take for its own.
/// @returns nothing where the runs have no thrust
std::optional<StandFit> FitThrust(const std::vector<BenchRun>& runs);

/// Torque coefficient with the cell's offset, which small torques can't do without; one offset per
/// run.
std::optional<StandFit> FitTorque(const std::vector<BenchRun>& runs);

}  // namespace odmc
