#pragma once

#include <functional>
#include <vector>

#include "odmc/analysis/calibration.h"

namespace odmc {

/// Update time at one window length.
struct BenchmarkRow {
  double window_s = 0.0;
  double keyframe_rate_hz = 0.0;
  int states_in_window = 0;
  int threads = 1;
  TimingFigures wall, cpu;
};

/// Runs the estimator over a flight once per window length.
/// @param progress called with the share done (0 to 1), may be empty
std::vector<BenchmarkRow> Benchmark(const FlightLog& log, const DynamicModel& model,
                                    const EstimatorOptions& options,
                                    const std::vector<double>& windows_s,
                                    const std::function<void(double)>& progress = {});

}  // namespace odmc
