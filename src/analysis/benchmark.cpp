#include "odmc/analysis/benchmark.h"

namespace odmc {

std::vector<BenchmarkRow> Benchmark(const FlightLog& log, const DynamicModel& model,
                                    const EstimatorOptions& options,
                                    const std::vector<double>& windows_s,
                                    const std::function<void(double)>& progress) {
  std::vector<BenchmarkRow> rows;
  const auto n = static_cast<double>(windows_s.size());
  for (const double window_s : windows_s) {
    EstimatorOptions at_window = options;
    at_window.window_s = window_s;
    Estimator estimator(&model, at_window, !log.rotor_rms_only);
    const auto done = static_cast<double>(rows.size());
    const ReplayResult replay = Replay(log, &estimator, [&](double share) {
      if (progress) progress((done + share) / n);
    });
    rows.push_back({window_s, options.keyframe_rate_hz, StatesInWindow(replay), options.num_threads,
                    SummariseTiming(replay, &UpdateTiming::wall_ms),
                    SummariseTiming(replay, &UpdateTiming::cpu_ms)});
  }
  return rows;
}

}  // namespace odmc
