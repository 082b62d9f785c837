#include "odmc/model/vehicle.h"

#include <cmath>
#include <sstream>

namespace odmc {
namespace {

bool Fail(std::string* error, const std::string& what) {
  if (error != nullptr) *error = what;
  return false;
}

bool IsValidMount(const SensorMount& mount, const std::string& key, std::string* error) {
  if (!mount.p_BS.allFinite()) return Fail(error, key + ".p_BS_m is not finite");
  if (std::abs(mount.q_BS.norm() - 1.0) > 1e-3) {
    return Fail(error, key + ".q_BS_xyzw is not a unit quaternion");
  }
  return true;
}

}  // namespace

double Vehicle::ArmLength() const {
  double sum = 0.0;
  for (const Rotor& rotor : rotors) sum += rotor.p_BP.head<2>().norm();
  return rotors.empty() ? 0.0 : sum / static_cast<double>(rotors.size());
}

bool Vehicle::IsValid(std::string* error) const {
  if (!(mass_kg > 0.0) || !std::isfinite(mass_kg)) {
    return Fail(error, "mass_kg must be a positive number of kilograms");
  }
  if (!(gravity_m_s2 > 0.0) || !std::isfinite(gravity_m_s2)) {
    return Fail(error, "gravity_m_s2 must be a positive number");
  }
  if (!inertia_kg_m2.allFinite() || inertia_kg_m2.minCoeff() <= 0.0) {
    return Fail(error, "inertia_kg_m2 must be three positive numbers");
  }
  if (inertia_kg_m2.maxCoeff() > inertia_kg_m2.sum() - inertia_kg_m2.maxCoeff()) {
    return Fail(error, "inertia_kg_m2 breaks the triangle inequality of a rigid body");
  }
  if (rotors.size() < 3 || num_rotors() > kMaxRotors) {
    return Fail(error, "rotors must list 3 to " + std::to_string(kMaxRotors) + " rotors, not " +
                           std::to_string(rotors.size()));
  }
  for (size_t i = 0; i < rotors.size(); ++i) {
    const std::string key = "rotors[" + std::to_string(i) + "]";
    if (!rotors[i].p_BP.allFinite()) return Fail(error, key + ".position_m is not finite");
    if (std::abs(rotors[i].spin) != 1.0) return Fail(error, key + ".spin must be cw or ccw");
    if (!(rotors[i].radius_m > 0.0)) return Fail(error, key + ".radius_m must be positive");
    for (size_t j = 0; j < i; ++j) {
      if ((rotors[i].p_BP - rotors[j].p_BP).norm() < 1e-6) {
        return Fail(error, key + ".position_m is the same as that of rotors[" + std::to_string(j) +
                               "]: each rotor has its own place");
      }
    }
  }
  if (!IsValidMount(odometry, "odometry", error)) return false;
  return !imu || IsValidMount(*imu, "imu", error);
}

}  // namespace odmc
