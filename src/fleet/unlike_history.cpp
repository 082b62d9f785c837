#include "odmc/fleet/unlike_history.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace odmc {

std::string UnlikeHistory::Sentence(const std::string& unit) const {
  char text[200];
  const double share = 100.0 * (value - expected) / std::abs(expected);
  std::snprintf(text, sizeof text, " is %.4g %s, %.3g %% %s what earlier flights let expect (%.4g +- "
                "%.2g; chance in %.1g %%)",
                value, unit.c_str(), std::abs(share), share < 0.0 ? "below" : "above", expected,
                expected_sigma, 100.0 * p_value);
  return full_name + text;
}

std::vector<UnlikeHistory> CompareWithHistory(const ParameterSet& history,
                                              const DynamicModel& model, const ModelValues& values,
                                              const Eigen::VectorXd& sigma, double rate) {
  constexpr double kShown = 0.7;
  std::vector<UnlikeHistory> looked_at;
  for (int k = 0; k < model.num_parameters(); ++k) {
    const ModelParameter& p = model.parameters()[k];
    const ParameterEstimate* before = history.Find(p.full_name);
    if (!p.estimated || before == nullptr || !(before->scatter > 0.0)) continue;
    const double expected_sigma = std::hypot(before->sigma, before->scatter);
    if (!(sigma[k] < kShown * expected_sigma)) continue;
    const double moves = std::sqrt(expected_sigma * expected_sigma - sigma[k] * sigma[k]);
    const double z = std::abs(values[k] - before->value) / moves;
    looked_at.push_back(
        {p.full_name, values[k], before->value, expected_sigma, std::erfc(z / std::sqrt(2.0))});
  }
  std::vector<UnlikeHistory> unlike;
  for (UnlikeHistory& one : looked_at) {
    one.p_value = std::min(1.0, one.p_value * static_cast<double>(looked_at.size()));
    if (one.p_value < rate) unlike.push_back(one);
  }
  return unlike;
}

}  // namespace odmc
