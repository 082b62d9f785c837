#include "odmc/model/plausibility.h"

#include <cmath>
#include <cstdio>

namespace odmc {
namespace {

constexpr double kLeastInertiaRatio = 0.2, kMostInertiaRatio = 5.0;  // over nominal
constexpr double kMostTilt = 0.35;                                   // of gravity [rad]

std::string Text(const char* format, double a, double b) {
  char text[160];
  std::snprintf(text, sizeof text, format, a, b);
  return text;
}

void CheckInertia(const DynamicModel& model, const BodyProperties& body,
                  std::vector<std::string>* sentences) {
  const Eigen::Vector3d inertia = body.I_BBcm_B.diagonal();
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

void CheckGeometry(const DynamicModel& model, const BodyProperties& body,
                   std::vector<std::string>* sentences) {
  const double offset = body.p_BBcm.norm(), arm = model.vehicle().ArmLength();
  if (offset > arm) {
    sentences->push_back(Text(
        "centre_of_gravity: %.3f m from the origin, outside the rotors (%.3f m)", offset, arm));
  }
  const Eigen::Vector3d& g_W = body.g_W;
  const double tilt = std::atan2(g_W.head<2>().norm(), -g_W.z());
  if (tilt > kMostTilt) {
    sentences->push_back(Text("gravity: %.2f rad off vertical (at most %.2f)", tilt, kMostTilt));
  }
}

}  // namespace

std::vector<std::string> UnphysicalValues(const DynamicModel& model, const ModelValues& values,
                                          const Eigen::VectorXd& sigma) {
  std::vector<std::string> sentences;
  for (int i = 0; i < model.num_parameters(); ++i) {
    const ModelParameter& p = model.parameters()[i];
    if (!std::isfinite(values[i]) || !(sigma[i] >= 0.0) || !std::isfinite(sigma[i])) {
      return {p.full_name + " is not a number, or its sigma is none"};
    }
    if (!HasWrongSign(p.spec.sign, values[i], sigma[i])) continue;
    sentences.push_back(p.full_name + Text(" = %.3g +- %.2g", values[i], sigma[i]) + " " +
                        p.spec.unit +
                        (p.spec.sign == PhysicalSign::kNegative ? ": positive, feeds energy in"
                                                                : ": negative, unphysical"));
  }
  const BodyProperties body = model.Properties(values);
  CheckInertia(model, body, &sentences);
  CheckGeometry(model, body, &sentences);
  return sentences;
}

std::string ThrustDoubt(const DynamicModel& model, const ModelValues& values) {
  constexpr double kMostRatio = 3.0;
  const int k_f = model.IndexOf("thrust.k_f");
  if (k_f < 0) return "";
  const double start = model.parameters()[k_f].spec.prior_value, value = values[k_f];
  if (!(start > 0.0)) return "";
  const double ratio = value / start;
  if (ratio < kMostRatio && ratio > 1.0 / kMostRatio) return "";
  char text[200];
  std::snprintf(text, sizeof text,
                "thrust.k_f = %.3g N s^2 is %.3g times what it started from: check the unit of the "
                "rotor speeds, and mass_kg",
                value, ratio);
  return text;
}

}  // namespace odmc
