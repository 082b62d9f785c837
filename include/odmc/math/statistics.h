#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace odmc {

/// Median; 0 for an empty sample.
double Median(std::vector<double> sample);

/// Value below which a share `p` (0 to 1) of the sample lies, linearly interpolated; 0 where empty.
double Quantile(std::vector<double> sample, double p);

/// The value in the middle, of an even number the upper of the two: one that occurs in the sample,
/// where Median() may lie between two. The sample must not be empty.
template <typename Value>
Value MiddleOf(std::vector<Value> sample) {
  const auto middle = sample.begin() + static_cast<std::ptrdiff_t>(sample.size() / 2);
  std::nth_element(sample.begin(), middle, sample.end());
  return *middle;
}

/// Standard deviation of a zero-mean Gaussian with the sample's median of |x|: robust to outliers.
double RobustSigma(std::vector<double> sample);

/// The same without a copy: leaves the magnitudes in `sample`, in any order.
double RobustSigmaInPlace(std::vector<double>* sample);

/// Standard deviation of a zero-mean Gaussian by Huber's Proposal 2 (Robust Statistics, 2nd ed.,
/// section 5.2): squares count up to those of two sigma, so a fifth of the sample may be outliers.
/// Readings in steps have ties, of which a median takes the whole step; this one does not. 0 where
/// more than three quarters are zero.
double HuberSigma(const std::vector<double>& sample);

/// Chance that a chi-squared of `freedom` degrees of freedom, >= 1, exceeds `x`.
double ChiSquaredTail(double x, int freedom);

/// Standard deviation over the median of a quantity whose logarithm is normal.
/// @param sigma standard deviation of the logarithm
double LogNormalDeviation(double sigma);

}  // namespace odmc
