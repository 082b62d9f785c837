#include "odmc/trajectory/feasibility.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "odmc/text/format.h"
#include "odmc/text/number_text.h"
#include "odmc/text/refusal.h"
#include "odmc/trajectory/flatness.h"

namespace odmc {
namespace {

constexpr double kStep_s = 0.005;
constexpr double kLeastSamples = 200.0;
constexpr double kMostSamples = 200000.0;
// A value this much above its limit, relatively, is rounding.
constexpr double kRounding = 1e-9;

void Raise(double value, double* most) { *most = std::max(*most, value); }

void Include(const FlatReference& reference, double gravity, Feasibility* found) {
  const FlatAttitude flat = FlatAttitudeOf(reference, {0.0, 0.0, -gravity});
  const double thrust_over_weight = flat.specific_thrust / gravity;
  const Eigen::Vector3d thrust_W = reference.a_WB + Eigen::Vector3d(0.0, 0.0, gravity);
  Raise(reference.v_WB.norm(), &found->max_speed_m_s);
  Raise(reference.a_WB.norm(), &found->max_acceleration_m_s2);
  Raise(thrust_over_weight, &found->max_thrust_over_weight);
  found->min_thrust_over_weight = std::min(found->min_thrust_over_weight, thrust_over_weight);
  Raise(std::atan2(thrust_W.head<2>().norm(), thrust_W.z()), &found->max_tilt_rad);
  Raise(flat.w_WB_B.norm(), &found->max_body_rate_rad_s);
  Raise(std::abs(reference.d_yaw), &found->max_yaw_rate_rad_s);
}

void Compare(const std::string& what, double value, double limit, const std::string& unit,
             Feasibility* found) {
  if (value <= limit * (1.0 + kRounding)) return;
  found->violations.push_back("the " + what + " reaches " + Format("%.6g", value) + unit +
                              ", at most " + FormatNumber(limit) + " is allowed");
}

void CompareAll(const FlightLimits& limits, Feasibility* found) {
  Compare("speed", found->max_speed_m_s, limits.max_speed_m_s, " m/s", found);
  Compare("thrust over weight", found->max_thrust_over_weight, limits.max_thrust_over_weight, "",
          found);
  Compare("body rate", found->max_body_rate_rad_s, limits.max_body_rate_rad_s, " rad/s", found);
  Compare("yaw rate", found->max_yaw_rate_rad_s, limits.max_yaw_rate_rad_s, " rad/s", found);
  if (found->min_thrust_over_weight < limits.min_thrust_over_weight * (1.0 - kRounding)) {
    found->violations.push_back("the thrust over weight falls to " +
                                Format("%.6g", found->min_thrust_over_weight) + ", at least " +
                                FormatNumber(limits.min_thrust_over_weight) + " is needed");
  }
}

// Visitor that says which field is not positive.
struct PositiveCheck {
  std::string error;
  void Field(const char* key, const double* value) {
    if (std::isfinite(*value) && *value > 0.0) return;
    error = std::string(key) + " must be positive, not " + FormatNumber(*value);
  }
};

}  // namespace

bool FlightLimits::IsValid(std::string* error) const {
  PositiveCheck check;
  FlightLimits(*this).Visit(&check);
  if (!check.error.empty()) return Invalid(error, check.error);
  if (!(max_thrust_over_weight > 1.0)) {
    return Invalid(error, "max_thrust_over_weight must be above 1, the thrust of hover, not " +
                              FormatNumber(max_thrust_over_weight));
  }
  if (!(min_thrust_over_weight < 1.0)) {
    return Invalid(error, "min_thrust_over_weight must be below 1, the thrust of hover, not " +
                              FormatNumber(min_thrust_over_weight));
  }
  return true;
}

Feasibility CheckFeasibility(const std::function<FlatReference(double)>& at, double start_s,
                             double end_s, const FlightLimits& limits, double gravity) {
  if (!(std::isfinite(start_s) && std::isfinite(end_s) && start_s <= end_s)) {
    throw std::invalid_argument("a span to check must be finite and end after its start, not " +
                                FormatNumber(start_s) + " s to " + FormatNumber(end_s) + " s");
  }
  Feasibility found;
  found.min_thrust_over_weight = std::numeric_limits<double>::infinity();
  const int pieces = static_cast<int>(
      std::clamp(std::ceil((end_s - start_s) / kStep_s), kLeastSamples, kMostSamples));
  for (int i = 0; i <= pieces; ++i) {
    const double time_s = start_s + (end_s - start_s) * i / pieces;
    const FlatReference reference = at(time_s);
    if (!IsFinite(reference)) {
      found.violations.push_back("the reference is not finite at " + FormatNumber(time_s) + " s");
      return found;
    }
    if (!reference.standing) Include(reference, gravity, &found);
  }
  CompareAll(limits, &found);
  return found;
}

}  // namespace odmc
