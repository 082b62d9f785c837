#pragma once

#include <cstddef>
#include <vector>

#include "odmc/estimator/estimator.h"
#include "odmc/sensing/samples.h"

/// Flights that tests feed to an estimator step by step; where no test looks in between, Replay()
/// does it.
namespace odmc::testing_support {

/// A recorded flight's samples in the order of a live one: before each pose the rotors' and the
/// IMU's up to its stamp.
class FlightFeed {
 public:
  /// @param log outlives the feed
  explicit FlightFeed(const FlightLog& log) : log_(log) {}

  bool AtEnd() const { return pose_ == log_.odometry.size(); }

  /// The pose with which the next step ends. @pre not at the end
  const OdometrySample& next_pose() const { return log_.odometry[pose_]; }

  /// Hands the samples up to the next pose, and that, to `add(sample)`. @pre not at the end
  template <typename Add>
  void Next(const Add& add) {
    HandOver(log_.rotors, &rotor_, add);
    HandOver(log_.imu, &imu_, add);
    add(log_.odometry[pose_++]);
  }

  /// The same to an estimator.
  void Next(Estimator* estimator) {
    Next([estimator](const auto& sample) { estimator->Add(sample); });
  }

 private:
  template <typename Sample, typename Add>
  void HandOver(const std::vector<Sample>& samples, size_t* at, const Add& add) const {
    while (*at < samples.size() && samples[*at].stamp <= next_pose().stamp) add(samples[(*at)++]);
  }

  const FlightLog& log_;
  size_t pose_ = 0, rotor_ = 0, imu_ = 0;
};

/// Lets an estimator work off what it was given, and shows each update's snapshot to `see`.
template <typename See>
void Drain(Estimator* estimator, const See& see) {
  do {
    if (const Snapshot* snapshot = estimator->Step()) see(*snapshot);
  } while (estimator->made_progress());
}

}  // namespace odmc::testing_support
