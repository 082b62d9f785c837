#pragma once

#include <cmath>

namespace odmc {

/// Hann window at `x` widths from its middle: 1 there, 0 from half a width on. Of a series averaged
/// with it, half the amplitude is left at one over the width.
inline double Hann(double x) {
  return std::abs(x) < 0.5 ? 0.5 + 0.5 * std::cos(2.0 * M_PI * x) : 0.0;
}

/// Width below which accelerations of rotors count [s]: above 4 Hz the derivative of measured
/// speeds is mostly noise, and a noisy regressor makes its coefficient small.
constexpr double kRotorRatesWindow_s = 0.25;

}  // namespace odmc
