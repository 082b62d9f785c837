#include "odmc/analysis/ground_spans.h"

#include <algorithm>

#include "odmc/estimator/phase_watch.h"
#include "odmc/math/ring.h"
#include "odmc/sensing/stream_pace.h"

namespace odmc {
namespace {

constexpr double kShareOfPeriod = 0.8;  // of a keyframe's, between two samples that are looked at
constexpr double kLongestStep_s = 1.0;  // a longer hole counts neither as ground nor as flight
constexpr double kMaxGap_s = 0.06;      // as EstimatorOptions::max_gap_s
constexpr double kKept_s = 10.0;        // of rotor speeds, the longest interval

/// Rotor speeds of one interval after the other.
class RotorReader {
 public:
  explicit RotorReader(const std::vector<RotorSample>& samples)
      : samples_(samples), hole_s_(PaceOf(samples).Hole_s(kMaxGap_s)) {}

  std::optional<RotorInterval> Read(Stamp from, Stamp to) {
    while (next_ < samples_.size() && (queue_.empty() || queue_.back().stamp < to)) {
      queue_.push_back(samples_[next_++]);
    }
    while (queue_.size() > 2 && queue_[1].stamp < from - FromSeconds(kKept_s)) queue_.pop_front();
    return ReduceRotors(queue_, from, to, hole_s_);
  }

 private:
  const std::vector<RotorSample>& samples_;
  const double hole_s_;
  size_t next_ = 0;
  Ring<RotorSample> queue_;
};

}  // namespace

GroundSpans FindGroundSpans(const FlightLog& log, const DynamicModel& model,
                            const ModelValues& values, const PhaseOptions& options,
                            double keyframe_rate_hz) {
  GroundSpans result;
  if (log.rotors.empty()) return result;
  OdometryNoiseEstimator noise({0.0, 0.0, 0.0, 0.0});
  PhaseWatch phases(&model, options, false);
  phases.Know(values, 0.0);
  RotorReader rotors(log.rotors);
  const OdometrySample* last = nullptr;
  double seen_s = 0.0;
  const double least_step_s = kShareOfPeriod / keyframe_rate_hz;
  const double hole_s = std::max(PaceOf(log.odometry).Hole_s(kMaxGap_s), 1.5 / keyframe_rate_hz);
  // Poses that repeat count here: a vehicle that stands may well have the same one all the time.
  for (const OdometrySample& sample : log.odometry) {
    noise.Add(sample);
    const double dt = last != nullptr ? ToSeconds(sample.stamp - last->stamp) : 0.0;
    if (last != nullptr && dt < least_step_s) continue;
    const bool is_first = last == nullptr || dt > hole_s;
    phases.Update(sample, is_first ? std::nullopt : rotors.Read(last->stamp, sample.stamp),
                  noise.Noise(), is_first);
    last = &sample;
    if (dt < kLongestStep_s) seen_s += dt;
    ++result.airborne_keyframes;
  }
  result.spans = NotInFlight(phases.detector().spans());
  for (const auto& [from, to] : result.spans) result.on_ground_s += ToSeconds(to - from);
  result.on_ground_s = std::min(result.on_ground_s, seen_s);
  const double share = seen_s > 0.0 ? 1.0 - result.on_ground_s / seen_s : 0.0;
  result.airborne_keyframes =
      static_cast<long>(share * static_cast<double>(result.airborne_keyframes));
  return result;
}

}  // namespace odmc
