#include "odmc/model/vehicle.h"

#include <cmath>

#include "odmc/model/plausibility.h"
#include "odmc/model/vehicle_units.h"
#include "odmc/text/format.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

bool IsValidMount(const SensorMount& mount, const std::string& key, std::string* error) {
  if (!mount.p_BS.allFinite()) return Invalid(error, key + ".p_BS_m is not finite");
  if (std::abs(mount.q_BS.norm() - 1.0) > 1e-3) {
    return Invalid(error, key + ".q_BS_xyzw is not a unit quaternion");
  }
  return true;
}

/// No moment of a rigid body exceeds the sum of the others; a flat one reaches it. Each of the
/// three is a guess known to 40 % (their prior), which breaks that rule by half as often as not. By
/// more than the sum again, they are not the moments of one body.
constexpr double kMostOverOthers = 2.0;

/// What the geometry does not allow; empty if it allows all.
std::string ImpossibleInertia(const Vehicle& vehicle) {
  const InertiaBounds bounds = InertiaBoundsOf(vehicle);
  for (int i = 0; i < 3; ++i) {
    const double inertia = vehicle.inertia_kg_m2[i];
    if (inertia >= bounds.least[i] && inertia <= bounds.most[i]) continue;
    const std::string text = Format(
        "inertia_kg_m2 is implausible: %.3g about %c cannot be that of %.3g kg on these "
        "rotors (%.2g to %.2g); is it in kg m^2 (1 g cm^2 is 1.0e-07 kg m^2)?",
        inertia, "xyz"[i], vehicle.mass_kg, bounds.least[i], bounds.most[i]);
    const UnitError slip = FindUnitError(vehicle);
    return slip.Refutes() ? text + " It fits if " + slip.Sentence() : text;
  }
  return "";
}

}  // namespace

double Vehicle::ArmLength() const {
  double sum = 0.0;
  for (const Rotor& rotor : rotors) sum += rotor.p_BP.head<2>().norm();
  return rotors.empty() ? 0.0 : sum / static_cast<double>(rotors.size());
}

bool Vehicle::IsValid(std::string* error) const {
  if (!(mass_kg > 0.0) || !std::isfinite(mass_kg)) {
    return Invalid(error, "mass_kg must be a positive number of kilograms");
  }
  if (!(gravity_m_s2 > 0.0) || !std::isfinite(gravity_m_s2)) {
    return Invalid(error, "gravity_m_s2 must be a positive number");
  }
  if (!inertia_kg_m2.allFinite() || inertia_kg_m2.minCoeff() <= 0.0) {
    return Invalid(error, "inertia_kg_m2 must be three positive numbers");
  }
  const double largest = inertia_kg_m2.maxCoeff();
  if (largest > kMostOverOthers * (inertia_kg_m2.sum() - largest)) {
    return Invalid(
        error,
        "inertia_kg_m2: one moment is more than twice the sum of the others, which no body "
        "has (triangle inequality)");
  }
  if (rotors.size() < 3 || num_rotors() > kMaxRotors) {
    return Invalid(error, "rotors must list 3 to " + std::to_string(kMaxRotors) + " rotors, not " +
                              std::to_string(rotors.size()));
  }
  for (size_t i = 0; i < rotors.size(); ++i) {
    const std::string key = "rotors[" + std::to_string(i) + "]";
    if (!rotors[i].p_BP.allFinite()) return Invalid(error, key + ".position_m is not finite");
    if (std::abs(rotors[i].spin) != 1.0) return Invalid(error, key + ".spin must be cw or ccw");
    if (!(rotors[i].radius_m > 0.0)) return Invalid(error, key + ".radius_m must be positive");
    for (size_t j = 0; j < i; ++j) {
      if ((rotors[i].p_BP - rotors[j].p_BP).norm() < 1e-6) {
        return Invalid(error, key + ".position_m is the same as that of rotors[" +
                                  std::to_string(j) + "]: each rotor has its own place");
      }
    }
  }
  const std::string impossible = ImpossibleInertia(*this);
  if (!impossible.empty()) return Invalid(error, impossible);
  if (!IsValidMount(odometry, "odometry", error)) return false;
  return !imu || IsValidMount(*imu, "imu", error);
}

}  // namespace odmc
