#pragma once

#include <cstddef>

namespace odmc {

/// A line over the index of values at even steps.
struct StraightLine {
  double middle = 0.0;  ///< index half way
  double mean = 0.0;    ///< there
  double slope = 0.0;   ///< per step

  double At(double index) const { return mean + slope * (index - middle); }
};

/// The line of least squares through `n` values; level for a single one.
StraightLine LineThrough(const double* values, size_t n);

}  // namespace odmc
