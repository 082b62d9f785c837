#pragma once

#include <string>
#include <vector>

#include "odmc/bench/benchmark.h"
#include "odmc/bench/recovery.h"

namespace odmc {

/// \file
/// What `recovery` and `benchmark` found, as report.json and text tables. What can't be had is null
/// or "-", never NaN.

std::string RecoveryReport(const Recovery& recovery, const RecoveryOptions& options,
                           const Vehicle& vehicle);
std::string BenchmarkReport(const std::vector<BenchmarkRow>& rows, const FlightLog& log,
                            const Vehicle& vehicle);

std::string RecoveryTable(const Recovery& recovery);
std::string BenchmarkTable(const std::vector<BenchmarkRow>& rows);

}  // namespace odmc
