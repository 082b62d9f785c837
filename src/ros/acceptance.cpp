#include "odmc/ros/acceptance.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace odmc {
namespace {

constexpr double kLeastInertiaRatio = 0.2, kMostInertiaRatio = 5.0;  // over nominal
constexpr double kShareOfPrior = 2.0;  // 10 % of the prior's sigma where 5 % of the value is asked
constexpr double kMostTilt = 0.35;     // of gravity [rad]

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

void CheckInertia(const DynamicModel& model, const Snapshot& snapshot,
                  std::vector<std::string>* sentences) {
  const Eigen::Vector3d inertia = snapshot.body.I_BBcm_B.diagonal();
  const Eigen::Vector3d ratio = inertia.cwiseQuotient(model.vehicle().inertia_kg_m2);
  for (int i = 0; i < 3; ++i) {
    if (ratio[i] >= kLeastInertiaRatio && ratio[i] <= kMostInertiaRatio) continue;
    sentences->push_back(
        std::string("inertia.") + "xyz"[i] +
        Text(" is %.2f times the nominal %.3g kg m^2", ratio[i], model.vehicle().inertia_kg_m2[i]));
  }
  // Within what its own uncertainty allows (10 %), no moment exceeds the sum of the others.
  const double largest = inertia.maxCoeff();
  if (largest > 1.1 * (inertia.sum() - largest)) {
    sentences->push_back(Text("inertia: %.3g kg m^2 is more than the other two together (%.3g)",
                              largest, inertia.sum() - largest));
  }
}

void CheckGeometry(const DynamicModel& model, const Snapshot& snapshot,
                   std::vector<std::string>* sentences) {
  const double offset = snapshot.body.p_BBcm.norm(), arm = model.vehicle().ArmLength();
  if (offset > arm) {
    sentences->push_back(Text(
        "centre_of_gravity: %.3f m from the origin, outside the rotors (%.3f m)", offset, arm));
  }
  const Eigen::Vector3d& g_W = snapshot.body.g_W;
  const double tilt = std::atan2(g_W.head<2>().norm(), -g_W.z());
  if (tilt > kMostTilt) {
    sentences->push_back(Text("gravity: %.2f rad off vertical (at most %.2f)", tilt, kMostTilt));
  }
}

}  // namespace

bool AcceptanceOptions::IsValid(std::string* error) const {
  if (accept_relative_sigma > 0.0 && accept_hold_s >= 0.0) return true;
  if (error != nullptr) {
    *error = "accept_relative_sigma must be positive and accept_hold_s not negative";
  }
  return false;
}

std::vector<std::string> UnphysicalValues(const DynamicModel& model, const Snapshot& snapshot) {
  std::vector<std::string> sentences;
  for (int i = 0; i < model.num_parameters(); ++i) {
    const ModelParameter& p = model.parameters()[i];
    if (!HasWrongSign(p.spec.sign, snapshot.values[i], snapshot.sigma[i])) continue;
    sentences.push_back(p.full_name +
                        Text(" = %.3g +- %.2g", snapshot.values[i], snapshot.sigma[i]) + " " +
                        p.spec.unit +
                        (p.spec.sign == PhysicalSign::kNegative ? ": positive, feeds energy in"
                                                                : ": negative, unphysical"));
  }
  CheckInertia(model, snapshot, &sentences);
  CheckGeometry(model, snapshot, &sentences);
  return sentences;
}

bool Acceptance::Update(const DynamicModel& model, const Snapshot& snapshot) {
  reasons_ = UnphysicalValues(model, snapshot);
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
