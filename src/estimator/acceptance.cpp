#include "odmc/estimator/acceptance.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "odmc/model/plausibility.h"

namespace odmc {
namespace {

constexpr double kShareOfPrior = 2.0;  // 10 % of the prior's sigma where 5 % of the value is asked

std::string Text(const char* format, double a, double b) {
  char text[160];
  std::snprintf(text, sizeof text, format, a, b);
  return text;
}

/// Largest sigma to accept. A value that may be zero is judged against what was known before, too:
/// its prior or its natural size.
double SigmaLimit(const ParameterSpec& spec, double value, double share) {
  const double relative = share * std::abs(value);
  if (spec.transform == ParameterTransform::kLog) return relative;
  return std::max(relative, kShareOfPrior * share * std::max(spec.prior_sigma, spec.scale));
}

}  // namespace

bool AcceptanceOptions::IsValid(std::string* error) const {
  if (accept_relative_sigma > 0.0 && accept_hold_s >= 0.0) return true;
  if (error != nullptr) {
    *error = "accept_relative_sigma must be positive and accept_hold_s not negative";
  }
  return false;
}

bool Acceptance::Update(const DynamicModel& model, const Snapshot& snapshot) {
  reasons_ = UnphysicalValues(model, snapshot.values, snapshot.sigma);
  const double share = options_.accept_relative_sigma;
  for (int i = 0; i < model.num_parameters(); ++i) {
    const ModelParameter& p = model.parameters()[i];
    if (!p.estimated) continue;
    if (!snapshot.observable[i]) {
      if (p.full_name == "thrust.k_f") reasons_.push_back(p.full_name + " is not observable yet");
      continue;
    }
    const double limit = SigmaLimit(p.spec, snapshot.values[i], share);
    if (snapshot.sigma[i] <= limit) continue;
    reasons_.push_back(p.full_name + Text(": sigma %.2g is above %.2g ", snapshot.sigma[i], limit) +
                       p.spec.unit);
  }
  if (!reasons_.empty()) {
    good_since_.reset();
    accepted_ = false;
    return false;
  }
  if (!good_since_) good_since_ = snapshot.stamp;
  accepted_ = ToSeconds(snapshot.stamp - *good_since_) >= options_.accept_hold_s;
  return accepted_;
}

void Acceptance::Reset() {
  good_since_.reset();
  accepted_ = false;
  reasons_.clear();
}

}  // namespace odmc
