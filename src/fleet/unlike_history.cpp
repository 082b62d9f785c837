#include "odmc/fleet/unlike_history.h"

#include <algorithm>
#include <cmath>

#include "odmc/fleet/flight_factor.h"
#include "odmc/text/format.h"

namespace odmc {

namespace {

/// Wind and how a load hangs are new on every flight and say nothing about the vehicle; where
/// gravity points does: mounts and centre of the thrust's axis are in it.
bool IsOfTheDay(const DynamicModel& model, const ModelParameter& p) {
  return BelongsToFlight(model, p) && p.effect != "gravity";
}

/// In per cent where the parameter has a size of its own, in its unit where it lies about zero.
std::string Distance(const UnlikeHistory& u, const std::string& unit) {
  constexpr double kHasSize = 5.0;  // sigmas
  const double off = std::abs(u.value - u.expected);
  if (std::abs(u.expected) > kHasSize * u.expected_sigma) {
    return Format("%.3g %%", 100.0 * off / std::abs(u.expected));
  }
  return Format("%.3g %s", off, unit.c_str());
}

}  // namespace

std::string UnlikeHistory::Sentence(const std::string& unit) const {
  return full_name +
         Format(" is %.4g %s, %s %s what earlier flights suggest (%.4g +- %.2g; chance in %.1g %%)",
                value, unit.c_str(), Distance(*this, unit).c_str(),
                value < expected ? "below" : "above", expected, expected_sigma, 100.0 * p_value);
}

std::vector<UnlikeHistory> CompareWithHistory(const ParameterSet& history,
                                              const DynamicModel& model, const ModelValues& values,
                                              const Eigen::VectorXd& sigma, double rate) {
  constexpr double kShown = 0.8;
  std::vector<UnlikeHistory> looked_at;
  for (int k = 0; k < model.num_parameters(); ++k) {
    const ModelParameter& p = model.parameters()[k];
    const ParameterEstimate* before = history.Find(p.full_name);
    if (!p.estimated || before == nullptr || !before->estimated || IsOfTheDay(model, p)) continue;
    const double expected_sigma = std::hypot(before->sigma, before->scatter);
    if (!(sigma[k] > 0.0) || !(sigma[k] < kShown * expected_sigma)) continue;
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

std::vector<UnlikeHistory> HistoryWatch::Look(double time_s, const DynamicModel& model,
                                              const ModelValues& values,
                                              const Eigen::VectorXd& sigma, double rate) {
  if (time_s < last_s_) Reset();
  last_s_ = time_s;
  std::map<std::string, double> since_s;
  std::vector<UnlikeHistory> held;
  for (UnlikeHistory& unlike : CompareWithHistory(history_, model, values, sigma, rate)) {
    const auto before = since_s_.find(unlike.full_name);
    const double from_s = before != since_s_.end() ? before->second : time_s;
    since_s[unlike.full_name] = from_s;
    if (time_s - from_s >= kHold_s) held.push_back(std::move(unlike));
  }
  since_s_ = std::move(since_s);
  return held;
}

}  // namespace odmc
