#include "odmc/analysis/replay.h"

#include <algorithm>
#include <limits>

namespace odmc {
namespace {

template <typename Sample>
void FeedUntil(const std::vector<Sample>& samples, Stamp stamp, size_t* next,
               Estimator* estimator) {
  while (*next < samples.size() && samples[*next].stamp <= stamp) {
    estimator->Add(samples[(*next)++]);
  }
}

template <typename Sample>
void Cut(Stamp from, Stamp to, std::vector<Sample>* samples) {
  samples->erase(std::remove_if(samples->begin(), samples->end(),
                                [=](const Sample& s) { return s.stamp < from || s.stamp > to; }),
                 samples->end());
}

/// Collects what the estimator says, update by update.
class Recorder {
 public:
  Recorder(Estimator* estimator, ReplayResult* result) : estimator_(estimator), result_(result) {}

  void Drain() {
    while (true) {
      const Snapshot* const snapshot = estimator_->Step();
      if (estimator_->counters().starts_anew != starts_anew_) StartAnew();
      if (!estimator_->made_progress()) return;
      See(estimator_->phases().seen());
      if (!snapshot) continue;
      if (result_->history.empty()) result_->first_airborne_s = snapshot->time_s;
      result_->history.push_back({snapshot->time_s, snapshot->values, snapshot->sigma});
      result_->timing.emplace_back(snapshot->time_s, snapshot->timing);
      result_->last = *snapshot;
    }
  }

 private:
  void See(const PhaseDetector::Seen& seen) {
    const Stamp last = result_->seen.empty() ? 0 : result_->seen.back().stamp;
    if (seen.stamp > last) result_->seen.push_back(seen);
  }

  /// What was learned so far came from no flight.
  void StartAnew() {
    starts_anew_ = estimator_->counters().starts_anew;
    result_->last.reset();
    result_->history = EstimateHistory();
    result_->timing.clear();
  }

  Estimator* estimator_;
  ReplayResult* result_;
  long starts_anew_ = 0;
};

/// The first pose; of a flight without, the first sample of all.
Stamp StartOf(const FlightLog& log) {
  if (!log.odometry.empty()) return log.odometry.front().stamp;
  Stamp start = std::numeric_limits<Stamp>::max();
  const auto lower = [&start](const auto& samples) {
    if (!samples.empty()) start = std::min(start, samples.front().stamp);
  };
  lower(log.imu);
  lower(log.rotors);
  lower(log.battery);
  lower(log.commands);
  return start == std::numeric_limits<Stamp>::max() ? 0 : start;
}

}  // namespace

ReplayResult Replay(const FlightLog& log, Estimator* estimator,
                    const std::function<void(double)>& progress,
                    const std::function<bool()>& give_up) {
  ReplayResult result;
  Recorder recorder(estimator, &result);
  size_t imu = 0, rotors = 0, battery = 0;
  bool given_up = false;
  for (size_t i = 0; i < log.odometry.size(); ++i) {
    const Stamp stamp = log.odometry[i].stamp;
    FeedUntil(log.rotors, stamp, &rotors, estimator);
    FeedUntil(log.imu, stamp, &imu, estimator);
    FeedUntil(log.battery, stamp, &battery, estimator);
    estimator->Add(log.odometry[i]);
    recorder.Drain();
    if (i % 64 != 0) continue;
    if (progress) progress(static_cast<double>(i) / static_cast<double>(log.odometry.size()));
    if (give_up && give_up()) {
      given_up = true;
      break;
    }
  }
  const Stamp end =
      given_up ? std::numeric_limits<Stamp>::min() : std::numeric_limits<Stamp>::max();
  FeedUntil(log.rotors, end, &rotors, estimator);
  FeedUntil(log.imu, end, &imu, estimator);
  estimator->Finish();
  recorder.Drain();
  if (progress) progress(1.0);
  result.counters = estimator->counters();
  result.phases = estimator->phases().spans();
  result.has_flown = estimator->phases().has_flown();
  result.ground_spans = NotInFlight(result.phases);
  result.stream_counters = estimator->stream_counters();
  return result;
}

void CutFlight(double start_s, double end_s, FlightLog* log) {
  const Stamp zero = StartOf(*log);
  const Stamp from =
      start_s > 0.0 ? zero + FromSeconds(start_s) : std::numeric_limits<Stamp>::min();
  const Stamp to = end_s > 0.0 ? zero + FromSeconds(end_s) : std::numeric_limits<Stamp>::max();
  Cut(from, to, &log->odometry);
  Cut(from, to, &log->imu);
  Cut(from, to, &log->rotors);
  Cut(from, to, &log->battery);
  Cut(from, to, &log->commands);
}

}  // namespace odmc
