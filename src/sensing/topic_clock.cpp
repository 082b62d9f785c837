#include "odmc/sensing/topic_clock.h"

#include <algorithm>

namespace odmc {
namespace {

constexpr double kStepBack_s = 0.5, kGoesOn_s = 0.5;

}  // namespace

bool IsStepBack(Stamp newest, Stamp stamp) { return ToSeconds(newest - stamp) > kStepBack_s; }

StampVerdict TopicClock::See(Stamp stamp, Stamp arrival) {
  if (!IsStepBack(newest_, stamp)) {
    old_since_ = 0;
    newest_ = std::max(newest_, stamp);
    return StampVerdict::kForward;
  }
  if (old_since_ == 0) old_since_ = arrival;
  if (ToSeconds(arrival - old_since_) <= kGoesOn_s) return StampVerdict::kRefused;
  old_since_ = 0;
  newest_ = stamp;
  return StampVerdict::kBack;
}

}  // namespace odmc
