#pragma once

#include <array>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "odmc/analysis/calibration.h"

namespace odmc {

/// What a benchmark goes through.
struct BenchmarkOptions {
  std::vector<std::string> solvers = {"incremental", "ceres"};
  std::vector<double> windows_s = {0.5, 1.0, 2.0, 5.0, 10.0};
  /// In a second, untimed pass every so many updates are compared with a full solve; 0: none.
  int full_solve_every = 20;
};

/// How far a solver's estimates were from a full solve of the same windows.
struct SolverComparison {
  long compared = 0;  ///< updates
  long failed = 0;    ///< full solves that were not usable
  double largest_parameter_difference = 0.0, p95_parameter_difference = 0.0;  ///< [sigma]
  double largest_sigma_difference = 0.0, p95_sigma_difference = 0.0;          ///< relative
  std::string parameter, sigma_parameter;                   ///< full names, of the largest
  double parameter_at_s = 0.0, sigma_parameter_at_s = 0.0;  ///< flight time of the largest
};

/// What the incremental solver did per update.
struct IncrementalWork {
  double aligned_share = 0.0;      ///< of the updates, solved as a whole
  double sweeping_share = 0.0;     ///< of the updates, older keyframes waited
  double eliminated_median = 0.0;  ///< keyframes
};

/// Part of an update.
struct UpdateStage {
  const char* name;
  double UpdateTiming::*wall_ms;
};

inline constexpr std::array<UpdateStage, 5> kUpdateStages = {{
    {"read", &UpdateTiming::read_ms},
    {"build", &UpdateTiming::build_ms},
    {"solve", &UpdateTiming::solve_ms},
    {"snapshot", &UpdateTiming::snapshot_ms},
    {"marginalize", &UpdateTiming::marginalize_ms},
}};

/// Update time of one solver at one window length.
struct BenchmarkRow {
  std::string solver;
  double window_s = 0.0;
  double keyframe_rate_hz = 0.0;
  int states_in_window = 0;
  int threads = 1;
  TimingFigures wall, cpu;                                 ///< of all updates after the start
  TimingFigures wall_start;                                ///< of all in it
  std::array<TimingFigures, kUpdateStages.size()> stages;  ///< wall time, by kUpdateStages
  double real_time_factor = 0.0;               ///< duration of the flight over that of the replay
  std::optional<IncrementalWork> work;         ///< of the incremental solver only
  std::optional<SolverComparison> comparison;  ///< empty: none was made
};

/// Runs the estimator over a flight once per solver and window length, and once more where it is
/// compared with full solves.
/// @param estimator the rest of its options
/// @param progress called with the share done (0 to 1), may be empty
std::vector<BenchmarkRow> Benchmark(const FlightLog& log, const DynamicModel& model,
                                    const EstimatorOptions& estimator,
                                    const BenchmarkOptions& options,
                                    const std::function<void(double)>& progress = {});

}  // namespace odmc
