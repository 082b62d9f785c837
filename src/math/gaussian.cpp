#include "odmc/math/gaussian.h"

#include <cmath>

namespace odmc {

Gaussian::Gaussian(int seed, int stream) {
  std::seed_seq sequence{seed, stream};
  generator_.seed(sequence);
}

double Gaussian::Uniform() { return (static_cast<double>(generator_() >> 11) + 1.0) * 0x1.0p-53; }

// Box and Muller.
double Gaussian::Next() {
  has_spare_ = !has_spare_;
  if (!has_spare_) return spare_;
  const double radius = std::sqrt(-2.0 * std::log(Uniform()));
  const double angle = 2.0 * 3.14159265358979323846 * Uniform();
  spare_ = radius * std::sin(angle);
  return radius * std::cos(angle);
}

Eigen::Vector3d Gaussian::Next3() {
  const double x = Next(), y = Next(), z = Next();
  return {x, y, z};
}

}  // namespace odmc
