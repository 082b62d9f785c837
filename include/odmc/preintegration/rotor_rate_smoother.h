#pragma once

#include <cstdint>

#include "odmc/math/ring.h"
#include "odmc/model/flight_state.h"

namespace odmc {

/// Width of the window in which accelerations of rotors are averaged [s]: above 4 Hz the derivative
/// of measured speeds is mostly noise, and a noisy regressor makes its coefficient small.
constexpr double kRotorRatesWindow_s = 0.25;

/// Accelerations of the rotors over consecutive intervals: about each, a parabola fitted to them
/// with the weights of a Hann window, so that a manoeuvre of 1 Hz keeps 99.5 % of its acceleration
/// (a weighted mean: 96 %). They go from one interval's mean speed to the next one's, since the
/// mean of all samples is quieter than the two at an interval's ends, and what noise adds to one
/// difference it takes from the next. The window has no phase, so an interval's average grows as
/// those after it come in, as far to one side as to the other; an interval that stands alone has
/// the difference of its ends.
class RotorRateSmoother {
 public:
  /// Of one interval.
  struct Rates {
    RotorVector acceleration;        ///< [rad/s²]
    RotorVector speed_squared_rate;  ///< [rad²/s³]
    double noise = 0.0;              ///< of an acceleration, per noise of a speed sample [1/s]
  };

  /// Forgets the intervals: the next one does not follow them.
  void Restart() { intervals_.clear(); }

  /// @param id anything that tells the interval
  /// @param time_s of its middle, > that of the one before
  /// @param dt its length [s], > 0
  /// @param num_samples that its means are of, > 0
  void Add(std::int64_t id, double time_s, double dt, const RotorState& mean, int num_samples);

  /// Calls `use` with every interval whose average the newest one has changed, oldest first.
  /// @param use takes (std::int64_t id, const Rates&)
  template <typename Use>
  void ForChanged(const Use& use) const {
    for (int i = 0; i < static_cast<int>(intervals_.size()); ++i) {
      const double from_newest_s = intervals_.back().time_s - intervals_[i].time_s;
      if (from_newest_s < 0.5 * kRotorRatesWindow_s) use(intervals_[i].id, About(i));
    }
  }

 private:
  struct Interval {
    std::int64_t id;
    double time_s, dt;
    RotorState mean;
    int num_samples;
  };

  Rates About(int middle) const;

  Ring<Interval> intervals_;
};

}  // namespace odmc
