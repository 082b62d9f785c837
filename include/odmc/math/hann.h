#pragma once

#include <cmath>

namespace odmc {

/// Hann window at `x` widths from its middle: 1 there, 0 from half a width on. Of a series averaged
/// with it, half the amplitude is left at one over the width.
inline double Hann(double x) {
  return std::abs(x) < 0.5 ? 0.5 + 0.5 * std::cos(2.0 * M_PI * x) : 0.0;
}

/// How many samples a window about sample `i` of `n` takes on either side: as many on one as on the
/// other, so that it does not lean, and none across a gap.
/// @param width of the window, in the unit of `time`
/// @param time of a sample
/// @param follows true if a sample follows the one before it without a gap
template <typename Time, typename Follows>
int HannReach(int i, int n, double width, const Time& time, const Follows& follows) {
  int reach = 0;
  while (i - reach - 1 >= 0 && i + reach + 1 < n && follows(i - reach) && follows(i + reach + 1) &&
         Hann((time(i - reach - 1) - time(i)) / width) > 0.0 &&
         Hann((time(i + reach + 1) - time(i)) / width) > 0.0) {
    ++reach;
  }
  return reach;
}

}  // namespace odmc
