#include "odmc/math/statistics.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace odmc {
namespace {

double QuantileOfSorted(const std::vector<double>& sample, double p) {
  if (sample.empty()) return 0.0;
  const double position = p * static_cast<double>(sample.size() - 1);
  const size_t below = static_cast<size_t>(position);
  const size_t above = std::min(below + 1, sample.size() - 1);
  const double fraction = position - static_cast<double>(below);
  return (1.0 - fraction) * sample[below] + fraction * sample[above];
}

}  // namespace

double Quantile(std::vector<double> sample, double p) {
  std::sort(sample.begin(), sample.end());
  return QuantileOfSorted(sample, p);
}

double Median(std::vector<double> sample) { return Quantile(std::move(sample), 0.5); }

double RobustSigma(std::vector<double> sample) { return RobustSigmaInPlace(&sample); }

double RobustSigmaInPlace(std::vector<double>* sample) {
  for (double& x : *sample) x = std::abs(x);
  std::sort(sample->begin(), sample->end());
  return 1.4826 * QuantileOfSorted(*sample, 0.5);
}

}  // namespace odmc
