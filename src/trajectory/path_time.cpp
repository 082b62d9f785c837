#include "path_time.h"

#include <algorithm>
#include <cmath>

namespace odmc {

Derivatives SmoothStep(double t, double width) {
  if (t <= 0.0) return {};
  if (t >= width) return {1.0, 0.0, 0.0, 0.0, 0.0};
  const double s = t / width;
  const double s2 = s * s, s3 = s2 * s;
  const double w2 = width * width;
  return {s2 * s2 * (35.0 + s * (-84.0 + s * (70.0 - 20.0 * s))),
          s3 * (140.0 + s * (-420.0 + s * (420.0 - 140.0 * s))) / width,
          s2 * (420.0 + s * (-1680.0 + s * (2100.0 - 840.0 * s))) / w2,
          s * (840.0 + s * (-5040.0 + s * (8400.0 - 4200.0 * s))) / (w2 * width),
          (840.0 + s * (-10080.0 + s * (25200.0 - 16800.0 * s))) / (w2 * w2)};
}

Derivatives SmoothStart(double t, double width) {
  const Derivatives step = SmoothStep(t, width);
  if (t >= width) return {t - 0.5 * width, 1.0, 0.0, 0.0, 0.0};
  const double s = std::max(0.0, t / width);
  const double integral = std::pow(s, 5) * (7.0 + s * (-14.0 + s * (10.0 - 2.5 * s)));
  return {width * integral, step[0], step[1], step[2], step[3]};
}

Derivatives Scaled(double factor, Derivatives value) {
  for (double& order : value) order *= factor;
  return value;
}

Derivatives Difference(Derivatives a, const Derivatives& b) {
  for (size_t k = 0; k < a.size(); ++k) a[k] -= b[k];
  return a;
}

}  // namespace odmc
