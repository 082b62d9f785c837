#include "odmc/math/line.h"

namespace odmc {

StraightLine LineThrough(const double* values, size_t n) {
  const auto count = static_cast<double>(n);
  StraightLine line;
  line.middle = 0.5 * (count - 1.0);
  double sum = 0.0, square = 0.0;
  for (size_t i = 0; i < n; ++i) {
    const double along = static_cast<double>(i) - line.middle;
    line.mean += values[i] / count;
    sum += along * values[i];
    square += along * along;
  }
  if (square > 0.0) line.slope = sum / square;
  return line;
}

}  // namespace odmc
