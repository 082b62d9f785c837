#pragma once

#include <nlohmann/json_fwd.hpp>

#include "odmc/analysis/calibration.h"
#include "odmc/text/table.h"

namespace odmc {

/// median, p95, p99, max [ms].
nlohmann::ordered_json QuantilesJson(const TimingFigures& f);

/// The cells of `start`, then median, p95, p99, max [ms] and the number of updates.
TableRow TimingRow(const TableRow& start, const TimingFigures& f);

}  // namespace odmc
