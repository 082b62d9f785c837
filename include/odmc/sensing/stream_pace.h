#pragma once

#include <algorithm>
#include <optional>
#include <vector>

#include "odmc/sensing/samples.h"

namespace odmc {

/// How far apart the samples of a stream usually are, and from which length on a pause is a hole.
/// Thread-compatible.
class StreamPace {
 public:
  /// Stamps step forward; others are left out.
  void Add(Stamp stamp) {
    if (last_ && stamp <= *last_) return;
    if (last_) {
      const double dt = ToSeconds(stamp - *last_);
      if (step_s_ == 0.0) step_s_ = dt;
      step_s_ += kNews * (std::min(dt, 2.0 * step_s_) - step_s_);  // holes hardly count
    }
    last_ = stamp;
  }

  /// Usual time between two samples [s]; 0 before the second one.
  double step_s() const { return step_s_; }

  /// A pause longer than this is a hole [s]: of a stream that is slow all the time (telemetry of an
  /// ESC, visual odometry) one sample may be missing.
  /// @param least_s what is no hole in any stream
  double Hole_s(double least_s) const {
    return std::max(least_s, kHole * std::min(step_s_, kSlowest_s));
  }

 private:
  static constexpr double kNews = 0.05, kHole = 2.5;
  /// Between samples farther apart than this a vehicle may have done anything.
  static constexpr double kSlowest_s = 0.4;

  std::optional<Stamp> last_;
  double step_s_ = 0.0;
};

/// Pace of recorded samples.
template <typename Sample>
StreamPace PaceOf(const std::vector<Sample>& samples) {
  StreamPace pace;
  for (const Sample& sample : samples) pace.Add(sample.stamp);
  return pace;
}

}  // namespace odmc
