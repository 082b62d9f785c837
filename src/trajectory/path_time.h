#pragma once

#include <array>

namespace odmc {

/// A value and its first four derivatives by time.
using Derivatives = std::array<double, 5>;

/// Smooth step 35 s⁴ - 84 s⁵ + 70 s⁶ - 20 s⁷ from 0 to 1 over `width`: its first three derivatives
/// vanish at both ends.
Derivatives SmoothStep(double t, double width);

/// Integral of SmoothStep(): at rest before 0, passing at full rate after `width`.
Derivatives SmoothStart(double t, double width);

/// `factor` times `value`.
Derivatives Scaled(double factor, Derivatives value);

/// Derivative by derivative.
Derivatives Difference(Derivatives a, const Derivatives& b);

}  // namespace odmc
