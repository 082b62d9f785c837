#pragma once

#include <algorithm>
#include <limits>

#include "odmc/estimator/change_detector.h"
#include "odmc/model/vehicle.h"
#include "odmc/window/window.h"

namespace odmc {

/// Shows a change detector what the window's intervals leave unexplained. Thread-compatible.
class ChangeWatch {
 public:
  explicit ChangeWatch(const Vehicle& vehicle);

  /// Looks at the intervals that are new and old enough: the newest states still give way to a
  /// change, those a little older can't. @returns true once per change
  bool Look(const Window& window);
  /// The chain of states ends.
  void Break() { detector_.Break(); }
  /// The same, and the clock is another one.
  void Restart() {
    detector_.Break();
    seen_ = kNothing;
  }
  /// Keyframes after `newest` were taken back.
  void TakeBack(Stamp newest) { seen_ = std::min(seen_, newest); }

 private:
  static constexpr Stamp kNothing = std::numeric_limits<Stamp>::min();

  ChangeDetector detector_;
  Stamp seen_ = kNothing;  // start of the newest interval it was given
};

}  // namespace odmc
