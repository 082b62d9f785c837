#pragma once

#include <vector>

namespace odmc {

/// One number per flight, normal about what the vehicle has: noise of known sigma, and a scatter
/// between flights that is not known.
struct ScalarHistory {
  std::vector<double> value, sigma;  ///< an infinite sigma: the flight says nothing
  std::vector<double> time;          ///< axis of a trend
};

/// Something that sets flights apart.
struct HistoryFinding {
  /// One flight apart, all from one on, or a drift over all.
  enum class Kind { kOutlier, kStep, kTrend };
  Kind kind = Kind::kOutlier;
  int flight = 0;  ///< that one; the first after a step
  double size = 0.0, sigma = 0.0;
  double log_p = 0.0;  ///< logarithm of its p-value, all candidates of all kinds accounted for
};

/// Mean, scatter and what was found, by generalised least squares with the scatter's variance from
/// the generalised Q statistic (Paule and Mandel, J. Res. NBS 87, 1982; DerSimonian and Kacker,
/// 2007).
struct HistoryFit {
  double mean = 0.0, variance = 0.0;  ///< of the scatter
  std::vector<HistoryFinding> findings;
};

/// Adds findings one by one, the likeliest first, up to three at a time where they are significant
/// only together, and takes back what is not significant (p below `rate`) beside the others.
/// @param rate of false alarms for this history
HistoryFit ExamineHistory(const ScalarHistory& history, double rate);

/// Value of `by` on a flight: what a finding's size is multiplied with.
double EffectOf(const HistoryFinding& finding, const ScalarHistory& history, int flight);

}  // namespace odmc
