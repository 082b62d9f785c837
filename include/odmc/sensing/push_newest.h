#pragma once

#include "odmc/math/ring.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// Appends a sample to those that wait for a keyframe and lets go of what is ten seconds older:
/// no interval is that long, and a stream may run for hours after the others have died.
template <typename Sample>
void PushNewest(const Sample& sample, Ring<Sample>* waiting) {
  constexpr double kLongestWait_s = 10.0;
  waiting->push_back(sample);
  while (ToSeconds(sample.stamp - waiting->front().stamp) > kLongestWait_s) waiting->pop_front();
}

}  // namespace odmc
