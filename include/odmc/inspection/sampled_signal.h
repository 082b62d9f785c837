#pragma once

#include <Eigen/Core>
#include <vector>

namespace odmc {

/// What is longer than this between two samples is a gap of their stream, whose usual step is
/// `usual_s`: 3.5 of these or 20 ms, whichever is more.
double LongestStep(double usual_s);

/// Channels over time, linear between samples on their own stamps. Means over spans are exact
/// integrals of these lines, so signals of different rates meet in the same band without delay.
class SampledSignal {
 public:
  /// @param times_s strictly increasing
  /// @param values  channels×n, one column a sample
  SampledSignal(std::vector<double> times_s, Eigen::MatrixXd values);

  int channels() const { return static_cast<int>(values_.rows()); }
  int size() const { return static_cast<int>(times_s_.size()); }
  double first_s() const { return times_s_.front(); }
  double last_s() const { return times_s_.back(); }
  /// Median distance of samples [s].
  double step_s() const { return step_s_; }
  const std::vector<double>& times_s() const { return times_s_; }
  const Eigen::MatrixXd& values() const { return values_; }

  /// True if [from_s, to_s] lies within the samples and touches no gap.
  bool Covers(double from_s, double to_s) const;

  /// Value at `t_s`; held at the ends.
  Eigen::VectorXd At(double t_s) const;

  /// Mean over [from_s, to_s]. @pre from_s < to_s and Covers()
  Eigen::VectorXd Mean(double from_s, double to_s) const;

 private:
  /// Index of the last sample at or before `t_s`, at most size() - 2.
  int Before(double t_s) const;
  /// Integral from the first sample to `t_s`.
  Eigen::VectorXd Integral(double t_s) const;

  std::vector<double> times_s_;
  Eigen::MatrixXd values_, integral_;
  std::vector<int> gaps_before_;  // how many gaps end at or before a sample
  double step_s_ = 0.0;
};

}  // namespace odmc
