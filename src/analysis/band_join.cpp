#include "odmc/analysis/band_join.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "odmc/math/statistics.h"

namespace odmc {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kErrorRate = ReactionCheck::kErrorRate;  // of every test here
constexpr double kErrorSigmas = 3.29;                     // the same, two-sided, normal
constexpr double kShown = 0.5;      // relative sigma above which nothing is shown
constexpr double kAnywhere = 10.0;  // answers to disturbances look like any inertia of this range

/// Bands [from, to), joined in logarithms.
struct Join {
  double weight = 0.0, mean = 0.0, chi_squared = 0.0, slope = 0.0, slope_sigma = 0.0, spread = 0.0;
  double sigma = 0.0;
};

Join JoinRange(const std::vector<BandEstimate>& bands, size_t from, size_t to) {
  Join join;
  double of_log = 0.0, of_frequency = 0.0;
  const auto weight = [&](size_t i) {
    const double relative = std::max(1e-6, bands[i].sigma / bands[i].value);
    return 1.0 / (relative * relative);
  };
  const auto frequency = [&](size_t i) {
    return 0.5 * std::log(bands[i].low_Hz * bands[i].high_Hz);
  };
  for (size_t i = from; i < to; ++i) {
    join.weight += weight(i);
    of_log += weight(i) * std::log(bands[i].value);
    of_frequency += weight(i) * frequency(i);
  }
  join.mean = of_log / join.weight;
  const double middle = of_frequency / join.weight;
  double square = 0.0, product = 0.0, noise = 0.0, systematic = 0.0;
  for (size_t i = from; i < to; ++i) {
    const double w = weight(i), off = std::log(bands[i].value) - join.mean;
    const double along = frequency(i) - middle;
    join.chi_squared += w * off * off;
    square += w * along * along;
    product += w * along * off;
    const double relative = bands[i].noise_sigma / bands[i].value, share = w / join.weight;
    noise += share * share * relative * relative;
    systematic += share * std::sqrt(std::max(0.0, 1.0 / w - relative * relative));
  }
  join.slope = product / square;
  join.slope_sigma = 1.0 / std::sqrt(square);
  // What is not noise is taken for common to all bands; and what a slope changes over them.
  join.spread = std::abs(join.slope) * std::sqrt(square / join.weight);
  join.sigma = std::sqrt(noise + systematic * systematic + join.spread * join.spread);
  return join;
}

/// Bands [from, to) as those in which rotor torque leads.
struct Range {
  size_t from, to;
  Join join;
  double log_evidence;
};

/// How likely the bands' values are if those of the range are one, and every other band, as the
/// value itself, lies anywhere within a factor of kAnywhere.
double LogEvidence(const std::vector<BandEstimate>& bands, size_t from, size_t to,
                   const Join& join) {
  double sum = 0.5 * std::log(2.0 * kPi / join.weight) - 0.5 * join.chi_squared;
  for (size_t i = from; i < to; ++i) {
    const double relative = std::max(1e-6, bands[i].sigma / bands[i].value);
    sum -= std::log(relative * std::sqrt(2.0 * kPi));
  }
  const double others = static_cast<double>(bands.size() - (to - from));
  return sum - (1.0 + others) * std::log(std::log(kAnywhere));
}

/// Mean and standard deviation of the logarithm, whichever range it is.
std::pair<double, double> AverageOf(const std::vector<Range>& ranges, double most) {
  double weight = 0.0, mean = 0.0, square = 0.0;
  for (const Range& range : ranges) {
    const double w = std::exp(range.log_evidence - most);
    weight += w;
    mean += w * range.join.mean;
    square += w * (range.join.sigma * range.join.sigma + range.join.mean * range.join.mean);
  }
  mean /= weight;
  return {mean, std::sqrt(std::max(0.0, square / weight - mean * mean))};
}

}  // namespace

void JoinBands(BandedQuantity* q) {
  q->value.reset();
  for (BandEstimate& band : q->bands) band.used = false;
  if (q->bands.size() < 2) {
    q->why = "fewer than two bands show it";
    return;
  }
  std::vector<Range> ranges;
  bool agree = false;
  for (size_t from = 0; from + 2 <= q->bands.size(); ++from) {
    for (size_t to = from + 2; to <= q->bands.size(); ++to) {
      const Join join = JoinRange(q->bands, from, to);
      const int freedom = static_cast<int>(to - from) - 1;
      if (ChiSquaredTail(join.chi_squared, freedom) < kErrorRate) continue;
      if (std::abs(join.slope) > kErrorSigmas * join.slope_sigma) continue;
      agree = true;
      if (join.slope + 1.0 < kErrorSigmas * join.slope_sigma || join.sigma > kShown) continue;
      ranges.push_back({from, to, join, LogEvidence(q->bands, from, to, join)});
    }
  }
  if (ranges.empty()) {
    q->why = agree
                 ? "where bands agree, they are too uncertain to tell rotor torque that leads from "
                   "rotor torque that answers disturbances"
                 : "no two bands agree";
    return;
  }
  const Range best = *std::max_element(
      ranges.begin(), ranges.end(),
      [](const Range& a, const Range& b) { return a.log_evidence < b.log_evidence; });
  for (size_t i = best.from; i < best.to; ++i) q->bands[i].used = true;
  const auto [mean, sigma] = AverageOf(ranges, best.log_evidence);
  q->value = std::exp(mean);
  q->sigma = *q->value * sigma;
  q->chi_squared = best.join.chi_squared;
  q->freedom = static_cast<int>(best.to - best.from) - 1;
  q->slope = best.join.slope;
  q->slope_sigma = best.join.slope_sigma;
}

}  // namespace odmc
