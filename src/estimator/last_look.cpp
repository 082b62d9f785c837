#include "odmc/estimator/last_look.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace odmc {
namespace {

constexpr double kFalseAlarms = 0.01;  // per flight

double Apart(const ThirdsDifference& difference) {
  const auto [low, high] =
      std::minmax_element(difference.values.begin(), difference.values.end());
  return *high - *low;
}

/// Share of the value beyond which the thirds may not lie apart; infinite where it does not matter.
double MostApart(const ModelParameter& parameter) {
  if (parameter.full_name == "thrust.k_f") return kThrustApart;
  if (parameter.effect == "drag") return 1.0;
  return HUGE_VAL;
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
    char text[300];
    std::snprintf(text, sizeof text,
                  "%s is %.3g in the first third of the flight, %.3g in the second and %.3g in the "
                  "last %s: more than chance makes of it",
                  p.full_name.c_str(), d.values[0], d.values[1], d.values[2],
                  p.spec.unit.c_str());
    Finding finding;
    finding.check = "last_look";
    finding.what = text;
    if (Apart(d) > MostApart(p) * std::abs(values[d.index])) {
      finding.leaves = Trust::kDoubtful;
      finding.mend = "look for what changed in between: a load, a contact, a sensor";
    }
    findings.push_back(finding);
  }
  return findings;
}

}  // namespace odmc
