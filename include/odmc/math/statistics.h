#pragma once

#include <vector>

namespace odmc {

/// Median; 0 for an empty sample.
double Median(std::vector<double> sample);

/// Value below which a share `p` (0 to 1) of the sample lies, linearly interpolated; 0 where empty.
double Quantile(std::vector<double> sample, double p);

/// Standard deviation of a zero-mean Gaussian with the sample's median of |x|: robust to outliers.
double RobustSigma(std::vector<double> sample);

/// The same without a copy: leaves the magnitudes in `sample`, in any order.
double RobustSigmaInPlace(std::vector<double>* sample);

/// Chance that a chi-squared of `freedom` degrees of freedom, >= 1, exceeds `x`.
double ChiSquaredTail(double x, int freedom);

}  // namespace odmc
