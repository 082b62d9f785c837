#include "odmc/inspection/sampled_signal.h"

#include <algorithm>
#include <utility>

#include "odmc/math/statistics.h"

namespace odmc {

double LongestStep(double usual_s) { return std::max(3.5 * usual_s, 0.02); }

SampledSignal::SampledSignal(std::vector<double> times_s, Eigen::MatrixXd values)
    : times_s_(std::move(times_s)), values_(std::move(values)) {
  const int n = size();
  integral_ = Eigen::MatrixXd::Zero(values_.rows(), n);
  gaps_before_.assign(static_cast<size_t>(n), 0);
  std::vector<double> steps;
  for (int i = 1; i < n; ++i) steps.push_back(times_s_[i] - times_s_[i - 1]);
  step_s_ = Median(steps);
  const double longest_s = LongestStep(step_s_);
  for (int i = 1; i < n; ++i) {
    const double step = times_s_[i] - times_s_[i - 1];
    integral_.col(i) = integral_.col(i - 1) + 0.5 * step * (values_.col(i - 1) + values_.col(i));
    gaps_before_[i] = gaps_before_[i - 1] + (step > longest_s ? 1 : 0);
  }
}

int SampledSignal::Before(double t_s) const {
  const auto after = std::upper_bound(times_s_.begin(), times_s_.end(), t_s);
  const int i = static_cast<int>(after - times_s_.begin()) - 1;
  return std::clamp(i, 0, std::max(0, size() - 2));
}

bool SampledSignal::Covers(double from_s, double to_s) const {
  if (size() < 2 || from_s < first_s() || to_s > last_s()) return false;
  return gaps_before_[Before(from_s)] == gaps_before_[Before(to_s) + 1];
}

Eigen::VectorXd SampledSignal::At(double t_s) const {
  const int i = Before(t_s);
  if (size() < 2) return values_.col(0);
  const double share = std::clamp((t_s - times_s_[i]) / (times_s_[i + 1] - times_s_[i]), 0.0, 1.0);
  return (1.0 - share) * values_.col(i) + share * values_.col(i + 1);
}

Eigen::VectorXd SampledSignal::Integral(double t_s) const {
  const int i = Before(t_s);
  const double since_s = t_s - times_s_[i];
  const double share = since_s / (times_s_[i + 1] - times_s_[i]);
  return integral_.col(i) +
         since_s * ((1.0 - 0.5 * share) * values_.col(i) + 0.5 * share * values_.col(i + 1));
}

Eigen::VectorXd SampledSignal::Mean(double from_s, double to_s) const {
  return (Integral(to_s) - Integral(from_s)) / (to_s - from_s);
}

}  // namespace odmc
