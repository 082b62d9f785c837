#include "odmc/estimator/thirds_consistency.h"

#include <algorithm>
#include <cmath>

#include "odmc/text/format.h"

namespace odmc {
namespace {

constexpr double kFalseAlarms = 0.01;  // per flight
constexpr double kNothing = 0.005;     // of the value: nobody minds

double Apart(const ThirdsDifference& difference) {
  const auto [low, high] = std::minmax_element(difference.values.begin(), difference.values.end());
  return *high - *low;
}

/// How far the thirds may lie apart; infinite where it does not matter.
double MostApart(const DynamicModel& model, const ModelValues& values, int index) {
  const ModelParameter& parameter = model.parameters()[index];
  if (parameter.full_name == "thrust.k_f") return kThrustApart * std::abs(values[index]);
  if (parameter.effect != "drag") return HUGE_VAL;
  // The largest drag of the three: along an axis that has next to none a share of it means nothing.
  double largest = 0.0;
  for (int i = 0; i < model.num_parameters(); ++i) {
    if (model.parameters()[i].effect == "drag") largest = std::max(largest, std::abs(values[i]));
  }
  return largest;
}

}  // namespace

double LastLookThreshold(int parameters) {
  // P(chi^2_2 > x) = exp(-x / 2).
  return -2.0 * std::log(kFalseAlarms / std::max(parameters, 1));
}

std::vector<Finding> LastLookFindings(const DynamicModel& model, const ModelValues& values,
                                      const std::vector<ThirdsDifference>& differences) {
  std::vector<Finding> findings;
  for (const ThirdsDifference& d : differences) {
    const ModelParameter& p = model.parameters()[d.index];
    if (Apart(d) < kNothing * std::abs(values[d.index])) continue;
    Finding finding;
    finding.check = "last_look";
    finding.what = Format(
        "%s is %.3g in the first third of the flight, %.3g in the second and %.3g in the "
        "last %s: more than chance makes of it",
        p.full_name.c_str(), d.values[0], d.values[1], d.values[2], p.spec.unit.c_str());
    if (Apart(d) > MostApart(model, values, d.index)) {
      finding.leaves = Trust::kDoubtful;
      finding.mend = "look for what changed in between: a load, a contact, a sensor";
    }
    findings.push_back(finding);
  }
  return findings;
}

}  // namespace odmc
