#include "odmc/model/plausibility.h"

#include <algorithm>
#include <cmath>

#include "odmc/text/format.h"

namespace odmc {
namespace {

constexpr double kLeastInertiaRatio = 0.2, kMostInertiaRatio = 5.0;  // over nominal
constexpr double kMostTilt = 0.35;                                   // of gravity [rad]
// Largest moment over the sum of the others; beyond 1 by rounding and by what a nominal one is off.
constexpr double kMostOverOthers = 1.1;
constexpr double kSigmas = 3.0;

double OverOthers(const Eigen::Vector3d& inertia) {
  const double largest = inertia.maxCoeff();
  return largest / (inertia.sum() - largest);
}

/// Three sigma of the largest moment minus the others, their correlations unknown [kg m²].
double InertiaLeeway(const DynamicModel& model, const Eigen::VectorXd& sigma) {
  double variance = 0.0;
  for (const char* name : {"inertia.x", "inertia.y", "inertia.z"}) {
    const int i = model.IndexOf(name);
    if (i >= 0) variance += sigma[i] * sigma[i];
  }
  return kSigmas * std::sqrt(variance);
}

void CheckInertia(const DynamicModel& model, const BodyProperties& body,
                  const Eigen::VectorXd& sigma, std::vector<std::string>* sentences) {
  const Eigen::Vector3d inertia = body.I_BBcm_B.diagonal();
  const Eigen::Vector3d ratio = inertia.cwiseQuotient(model.vehicle().inertia_kg_m2);
  for (int i = 0; i < 3; ++i) {
    if (ratio[i] >= kLeastInertiaRatio && ratio[i] <= kMostInertiaRatio) continue;
    sentences->push_back(std::string("inertia.") + "xyz"[i] +
                         Format(" is %.2f times the nominal %.3g kg m^2", ratio[i],
                                model.vehicle().inertia_kg_m2[i]));
  }
  // No moment exceeds the sum of the others, but for its own uncertainty, a few per cent, and what
  // the vehicle file has: a frozen one stays there.
  const double largest = inertia.maxCoeff();
  const double most = kMostOverOthers * std::max(1.0, OverOthers(model.vehicle().inertia_kg_m2));
  if (largest > most * (inertia.sum() - largest) + InertiaLeeway(model, sigma)) {
    sentences->push_back(Format("inertia: %.3g kg m^2 is more than the other two together (%.3g)",
                                largest, inertia.sum() - largest));
  }
}

void CheckGeometry(const DynamicModel& model, const BodyProperties& body,
                   std::vector<std::string>* sentences) {
  const double offset = body.p_BBcm.norm(), arm = model.vehicle().ArmLength();
  if (offset > arm) {
    sentences->push_back(Format(
        "centre_of_gravity: %.3f m from the origin, outside the rotors (%.3f m)", offset, arm));
  }
  const Eigen::Vector3d& g_W = body.g_W;
  const double tilt = std::atan2(g_W.head<2>().norm(), -g_W.z());
  if (tilt > kMostTilt) {
    sentences->push_back(Format("gravity: %.2f rad off vertical (at most %.2f)", tilt, kMostTilt));
  }
}

/// k_f in N/rpm² is 91 times too small, which the tip speed at hover shows (supersonic).
std::string ImplausibleThrust(double k_f, const Vehicle& vehicle) {
  constexpr char kHint[] =
      "is implausible; k_f is the thrust of one rotor in N/(rad/s)^2 (one in N/rpm^2 times 91.19)";
  const std::string text = Format("%.6g ", k_f) + kHint;
  if (k_f < 1e-11 || k_f > 1e-2) return text;
  const double hover_speed =
      std::sqrt(vehicle.mass_kg * vehicle.gravity_m_s2 / (vehicle.num_rotors() * k_f));
  const double tip_speed = hover_speed * vehicle.rotors.front().radius_m;
  if (tip_speed >= 2.0 && tip_speed <= 500.0) return "";
  return text + Format(": the propeller tips would hover at %.0f m/s", tip_speed);
}

std::string ImplausibleInertia(int axis, double value, const Vehicle& vehicle) {
  const InertiaBounds bounds = InertiaBoundsOf(vehicle);
  if (value >= bounds.least[axis] && value <= bounds.most[axis]) return "";
  return Format("%.3g kg m^2 cannot be that of %.3g kg on these rotors (%.2g to %.2g)", value,
                vehicle.mass_kg, bounds.least[axis], bounds.most[axis]);
}

/// Natural size of a parameter: what it starts from where that is positive by definition.
double SizeOf(const ParameterSpec& spec, double value) {
  return spec.transform == ParameterTransform::kLog ? value
                                                    : std::max(spec.scale, spec.prior_sigma);
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
    sentences.push_back(p.full_name + Format(" = %.3g +- %.2g", values[i], sigma[i]) + " " +
                        p.spec.unit +
                        (p.spec.sign == PhysicalSign::kNegative ? ": positive, feeds energy in"
                                                                : ": negative, unphysical"));
  }
  const BodyProperties body = model.Properties(values);
  CheckInertia(model, body, sigma, &sentences);
  CheckGeometry(model, body, &sentences);
  return sentences;
}

InertiaBounds InertiaBoundsOf(const Vehicle& vehicle) {
  // Payload and landing gear lie within that of the rotors' reach, too.
  constexpr double kReach = 2.0;
  // Motors and propellers are 15 to 40 % of a vehicle's mass.
  constexpr double kLeastMotorShare = 0.01;
  double reach = 0.0;
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const Rotor& rotor : vehicle.rotors) {
    reach = std::max(reach, rotor.p_BP.norm() + rotor.radius_m);
    middle += rotor.p_BP / vehicle.num_rotors();
  }
  Eigen::Vector3d square = Eigen::Vector3d::Zero();  // mean, of the hubs from their middle
  for (const Rotor& rotor : vehicle.rotors) {
    square += (rotor.p_BP - middle).cwiseAbs2() / vehicle.num_rotors();
  }
  const double motors_kg = kLeastMotorShare * vehicle.mass_kg;
  return {motors_kg * (Eigen::Vector3d::Constant(square.sum()) - square),
          Eigen::Vector3d::Constant(vehicle.mass_kg * std::pow(kReach * reach, 2))};
}

SettingDoubt DoubtOf(const std::string& full_name, const ParameterSpec& spec,
                     const ParameterSetting& setting, const Vehicle& vehicle) {
  // Squares of ratios beyond these do not fit beside one in double precision, and no mix-up of
  // units takes a value so far.
  constexpr double kMostValue = 1e6, kMostSigma = 1e8;
  const double value = setting.value.value_or(spec.prior_value);
  const bool is_log = spec.transform == ParameterTransform::kLog;
  if (setting.value && full_name == "thrust.k_f") {
    const std::string wrong = ImplausibleThrust(value, vehicle);
    if (!wrong.empty()) return {"value", wrong};
  }
  if (setting.value && full_name.rfind("inertia.", 0) == 0) {
    const std::string wrong = ImplausibleInertia(full_name.back() - 'x', value, vehicle);
    if (!wrong.empty()) return {"value", wrong};
  }
  const double size = SizeOf(spec, value), own = SizeOf(spec, spec.prior_value);
  if (!(std::abs(value) <= kMostValue * own) || (is_log && !(value >= own / kMostValue))) {
    return {"value", Format("%.3g %s is implausible; its natural size is %.2g", value,
                            spec.unit.c_str(), own)};
  }
  const double sigma = setting.sigma.value_or(size);
  if (!(sigma <= kMostSigma * size) || !(sigma >= size / kMostSigma)) {
    return {"sigma",
            Format("%.3g %s is implausible beside a natural size of %.2g; freeze what is known "
                   "exactly (state: frozen)",
                   sigma, spec.unit.c_str(), size)};
  }
  return {};
}

std::string InertiaDoubt(const Vehicle& vehicle) {
  constexpr double kRounding = 1e-6;  // of a flat body's own numbers
  const double ratio = OverOthers(vehicle.inertia_kg_m2);
  if (ratio <= 1.0 + kRounding) return "";
  return Format(
      "the vehicle file's inertia breaks the triangle inequality of a rigid body by %.2g "
      "%%: one moment is more than the other two together; it is used as it is",
      100.0 * (ratio - 1.0));
}

std::string ThrustDoubt(const DynamicModel& model, const ModelValues& values) {
  constexpr double kMostRatio = 3.0;
  const int k_f = model.IndexOf("thrust.k_f");
  if (k_f < 0) return "";
  const double start = model.parameters()[k_f].spec.prior_value, value = values[k_f];
  if (!(start > 0.0)) return "";
  const double ratio = value / start;
  if (ratio < kMostRatio && ratio > 1.0 / kMostRatio) return "";
  return Format(
      "thrust.k_f = %.3g N s^2 is %.3g times what it started from: check the unit of the "
      "rotor speeds, and mass_kg",
      value, ratio);
}

}  // namespace odmc
