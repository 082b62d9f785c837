#pragma once

#include <chrono>
#include <string>

#include "odmc/estimator/estimator.h"

namespace odmc {

/// Sees whether a flight that should teach goes on to. Thread-compatible.
class LearningProgress {
 public:
  /// Looks once in a while; says in the log when learning stops and when it goes on.
  /// @param missing stream the estimator waits for; may be empty
  /// @param is_expected something is estimated, and learning is not switched off
  void Look(const Estimator& estimator, const std::string& missing, bool is_expected);

  /// Why the flight has not taught anything for the last while: no keyframes, or none that hang
  /// together. Empty on the ground, and if it has.
  const std::string& interruption() const { return interruption_; }
  bool comes_on() const { return comes_on_; }  ///< keyframes did come

 private:
  using Clock = std::chrono::steady_clock;
  std::string Judge(const Estimator& estimator, const std::string& missing, bool is_expected);

  EstimatorCounters counted_;  // at the last look
  Clock::time_point looked_at_;
  std::string interruption_;
  bool comes_on_ = false;
};

}  // namespace odmc
