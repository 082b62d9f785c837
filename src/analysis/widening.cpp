#include "odmc/analysis/widening.h"

#include <algorithm>
#include <boost/math/distributions/students_t.hpp>

namespace odmc {

double Widening(double freedom) {
  constexpr double kThreeSigma = 0.99865;  // one-sided, of a normal variable
  constexpr double kLeast = 2.0;           // two values show next to nothing of their scatter
  if (!(freedom < 1e6)) return 1.0;
  const boost::math::students_t t(std::max(freedom, kLeast));
  return boost::math::quantile(t, kThreeSigma) / 3.0;
}

}  // namespace odmc
