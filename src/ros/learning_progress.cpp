#include "odmc/ros/learning_progress.h"

#include <ros/console.h>

#include <utility>

namespace odmc {
namespace {

constexpr std::chrono::milliseconds kPeriod(1500);

}  // namespace

void LearningProgress::Look(const Estimator& estimator, const std::string& missing,
                            bool is_expected) {
  if (Clock::now() - looked_at_ < kPeriod) return;
  const std::string interruption = Judge(estimator, missing, is_expected);
  if (interruption != interruption_ && !interruption.empty()) {
    ROS_WARN("%s", interruption.c_str());
  } else if (interruption.empty() && !interruption_.empty()) {
    ROS_INFO("learning goes on");
  }
  interruption_ = interruption;
}

std::string LearningProgress::Judge(const Estimator& estimator, const std::string& missing,
                                    bool is_expected) {
  const EstimatorCounters before = std::exchange(counted_, estimator.counters());
  const bool is_first = looked_at_ == Clock::time_point();
  const auto seen = [](const EstimatorCounters& c) { return c.keyframes + c.ground_keyframes; };
  comes_on_ = !is_first && seen(counted_) > seen(before);
  looked_at_ = Clock::now();
  if (is_first || !is_expected || !estimator.airborne()) return "";
  const long keyframes = counted_.keyframes - before.keyframes;
  const long gaps = counted_.gaps - before.gaps;
  if (keyframes < 0) return "";                                              // a new estimator
  if (keyframes == 0 && counted_.airborne_s > before.airborne_s) return "";  // near the ground
  if (keyframes == 0) {
    return "nothing is learned any more: no " + (missing.empty() ? "odometry" : missing);
  }
  if (2 * gaps < keyframes) return "";
  return "nothing is learned: gaps between most keyframes" +
         (missing.empty() ? " (odometry too slow, or stamps of the streams that do not agree)"
                          : ", " + missing + " missing or late");
}

}  // namespace odmc
