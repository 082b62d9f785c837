#include "odmc/bench/benchmark.h"

#include <algorithm>
#include <chrono>

#include "odmc/bench/full_solve.h"
#include "odmc/math/statistics.h"

namespace odmc {
namespace {

/// Shares of passes whose cost grows with the window, as shares of the whole.
class Passes {
 public:
  Passes(const BenchmarkOptions& options, const std::function<void(double)>& progress)
      : progress_(progress) {
    for (const double window_s : options.windows_s) total_ += window_s;
    total_ *= static_cast<double>(options.solvers.size()) * (options.full_solve_every > 0 ? 2 : 1);
  }

  /// @returns what the replay of the next pass is to call
  std::function<void(double)> Begin(double window_s) {
    const double start = done_;
    done_ += window_s;
    return [this, start, window_s](double share) {
      if (progress_) progress_((start + share * window_s) / total_);
    };
  }

 private:
  const std::function<void(double)>& progress_;
  double total_ = 0.0, done_ = 0.0;
};

IncrementalWork SummariseWork(const ReplayResult& replay) {
  IncrementalWork work;
  std::vector<double> eliminated;
  for (const auto& [time_s, timing] : replay.timing) {
    work.aligned_share += timing.aligned ? 1.0 : 0.0;
    work.sweeping_share += timing.sweeping ? 1.0 : 0.0;
    eliminated.push_back(timing.eliminated);
  }
  const double n = std::max(1.0, static_cast<double>(eliminated.size()));
  work.aligned_share /= n;
  work.sweeping_share /= n;
  work.eliminated_median = Median(eliminated);
  return work;
}

BenchmarkRow Time(const FlightLog& log, const DynamicModel& model, const EstimatorOptions& options,
                  const std::function<void(double)>& progress) {
  using Clock = std::chrono::steady_clock;
  Estimator estimator(&model, options, !log.rotor_rms_only);
  const Clock::time_point start = Clock::now();
  const ReplayResult replay = Replay(log, &estimator, progress);
  const double took_s = std::chrono::duration<double>(Clock::now() - start).count();
  BenchmarkRow row;
  row.solver = options.solver;
  row.window_s = options.window_s;
  row.keyframe_rate_hz = options.keyframe_rate_hz;
  row.states_in_window = StatesInWindow(replay);
  row.threads = options.num_threads;
  row.wall = SummariseTiming(replay, &UpdateTiming::wall_ms);
  row.cpu = SummariseTiming(replay, &UpdateTiming::cpu_ms);
  row.wall_start = SummariseTiming(replay, &UpdateTiming::wall_ms, TimingPart::kStart);
  for (size_t i = 0; i < kUpdateStages.size(); ++i) {
    row.stages[i] = SummariseTiming(replay, kUpdateStages[i].wall_ms);
  }
  row.real_time_factor = ToSeconds(log.odometry.back().stamp - log.odometry.front().stamp) / took_s;
  if (options.solver == "incremental") row.work = SummariseWork(replay);
  return row;
}

SolverComparison Compare(const FlightLog& log, const DynamicModel& model,
                         const EstimatorOptions& options, int every,
                         const std::function<void(double)>& progress) {
  Estimator estimator(&model, options, !log.rotor_rms_only);
  SolverComparison result;
  std::vector<double> parameters, sigmas;
  long update = 0;
  estimator.SetObserver([&](const SolvedWindow& solved) {
    if (++update % every != 0) return;
    const std::optional<FullSolveDifference> difference = CompareWithFullSolve(solved);
    if (!difference) {
      ++result.failed;
      return;
    }
    const double time_s = ToSeconds(estimator.last_keyframe_stamp() - estimator.start());
    parameters.push_back(difference->parameters);
    sigmas.push_back(difference->sigmas);
    if (difference->parameters > result.largest_parameter_difference) {
      result.largest_parameter_difference = difference->parameters;
      result.parameter = difference->worst_parameter;
      result.parameter_at_s = time_s;
    }
    if (difference->sigmas > result.largest_sigma_difference) {
      result.largest_sigma_difference = difference->sigmas;
      result.sigma_parameter = difference->worst_sigma;
      result.sigma_parameter_at_s = time_s;
    }
  });
  Replay(log, &estimator, progress);
  result.compared = static_cast<long>(parameters.size());
  result.p95_parameter_difference = Quantile(parameters, 0.95);
  result.p95_sigma_difference = Quantile(sigmas, 0.95);
  return result;
}

}  // namespace

std::vector<BenchmarkRow> Benchmark(const FlightLog& log, const DynamicModel& model,
                                    const EstimatorOptions& estimator,
                                    const BenchmarkOptions& options,
                                    const std::function<void(double)>& progress) {
  std::vector<BenchmarkRow> rows;
  Passes passes(options, progress);
  for (const std::string& solver : options.solvers) {
    for (const double window_s : options.windows_s) {
      EstimatorOptions of_row = estimator;
      of_row.solver = solver;
      of_row.window_s = window_s;
      rows.push_back(Time(log, model, of_row, passes.Begin(window_s)));
      if (options.full_solve_every == 0) continue;
      rows.back().comparison =
          Compare(log, model, of_row, options.full_solve_every, passes.Begin(window_s));
    }
  }
  return rows;
}

}  // namespace odmc
