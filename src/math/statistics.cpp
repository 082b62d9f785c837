#include "odmc/math/statistics.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>

namespace odmc {
namespace {

/// Linear between the two nearest; puts `sample` into another order.
double QuantileInPlace(std::vector<double>* sample, double p) {
  if (sample->empty()) return 0.0;
  const double position = p * static_cast<double>(sample->size() - 1);
  const double fraction = position - std::floor(position);
  const auto below = sample->begin() + static_cast<std::ptrdiff_t>(position);
  std::nth_element(sample->begin(), below, sample->end());
  const auto above = std::min_element(below + 1, sample->end());
  return (1.0 - fraction) * *below + fraction * (above == sample->end() ? *below : *above);
}

}  // namespace

double Quantile(std::vector<double> sample, double p) { return QuantileInPlace(&sample, p); }

double Median(std::vector<double> sample) { return Quantile(std::move(sample), 0.5); }

double RobustSigma(std::vector<double> sample) { return RobustSigmaInPlace(&sample); }

double RobustSigmaInPlace(std::vector<double>* sample) {
  for (double& x : *sample) x = std::abs(x);
  return 1.4826 * QuantileInPlace(sample, 0.5);
}

double HuberSigma(const std::vector<double>& sample) {
  constexpr double kMost = 2.0;
  constexpr double kMean = 0.92054;  // of min(z^2, kMost^2), z normal
  constexpr int kRounds = 50;
  constexpr double kSettled = 1e-4;
  double square = 0.0;
  for (const double x : sample) square += x * x;
  if (!(square > 0.0)) return 0.0;
  const auto n = static_cast<double>(sample.size());
  double variance = square / n;
  for (int round = 0; round < kRounds; ++round) {
    const double most = kMost * kMost * variance;
    double sum = 0.0;
    for (const double x : sample) sum += std::min(x * x, most);
    const double next = sum / (n * kMean);
    const bool settled = std::abs(next - variance) < kSettled * variance;
    variance = next;
    if (settled) break;
  }
  return std::sqrt(variance);
}

double ChiSquaredTail(double x, int freedom) {
  if (!(x > 0.0)) return 1.0;
  // Q(a + 1, y) = Q(a, y) + y^a e^-y / Gamma(a + 1), from Q(1, y) = e^-y or Q(1/2, y) = erfc(sqrt
  // y).
  const double y = 0.5 * x;
  double a = freedom % 2 == 0 ? 1.0 : 0.5;
  double tail = freedom % 2 == 0 ? std::exp(-y) : std::erfc(std::sqrt(y));
  for (; a + 0.5 < 0.5 * freedom; a += 1.0) {
    tail += std::exp(a * std::log(y) - y - std::lgamma(a + 1.0));
  }
  return std::min(tail, 1.0);
}

double LogNormalDeviation(double sigma) {
  const double spread = std::exp(sigma * sigma);
  return std::sqrt(spread * (spread - 1.0));
}

}  // namespace odmc
