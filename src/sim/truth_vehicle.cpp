#include "odmc/sim/truth_vehicle.h"

#include <map>
#include <optional>
#include <string>

namespace odmc {
namespace {

// The vehicle of all simulations in model.md, section 8.
constexpr double kMass = 0.75, kGravity = 9.81, kArm = 0.14534, kRadius = 0.0635;
constexpr int kRotors = 4;
const Eigen::Vector3d kInertia(2.5e-3, 2.1e-3, 4.3e-3);

// A coefficient of `vehicle` that behaves as that of the nominal vehicle, where one is known.
std::optional<double> Scaled(const std::string& full_name, const Vehicle& vehicle) {
  const double mass = vehicle.mass_kg / kMass;
  const double arm = vehicle.ArmLength() / kArm;
  const double radius = vehicle.rotors.front().radius_m / kRadius;
  const double weight = mass * vehicle.gravity_m_s2 / kGravity;
  const double thrust = weight * kRotors / vehicle.num_rotors() * radius * radius;
  const Eigen::Vector3d inertia = vehicle.inertia_kg_m2.cwiseQuotient(kInertia);
  const std::map<std::string, double> values = {
      {"thrust.k_f", 1.5e-6 * thrust},
      {"rotor_torque.k_m", 2.1e-8 * thrust * radius},
      {"drag.d_x", -0.30 * mass},
      {"drag.d_y", -0.25 * mass},
      {"drag.d_z", -0.20 * mass},
      {"viscous_torque.b_x", -3.0e-3 * inertia.x()},
      {"viscous_torque.b_y", -3.0e-3 * inertia.y()},
      {"viscous_torque.b_z", -1.5e-3 * inertia.z()},
      {"hvt.k_h", 0.007 * mass},
      {"centre_of_gravity.x", 0.010 * arm},
      {"centre_of_gravity.y", -0.006 * arm},
      {"centre_of_gravity.z", 0.015 * arm},
  };
  const auto it = values.find(full_name);
  return it != values.end() ? std::optional<double>(it->second) : std::nullopt;
}

}  // namespace

ModelValues DefaultTruth(const DynamicModel& model) {
  ModelValues truth = model.InitialValues();
  const Vehicle& vehicle = model.vehicle();
  for (int i = 0; i < model.num_parameters(); ++i) {
    const ModelParameter& parameter = model.parameters()[i];
    const auto setting = vehicle.parameters.find(parameter.full_name);
    const bool stated = setting != vehicle.parameters.end() && setting->second.value.has_value();
    if (stated || !parameter.estimated) continue;
    truth[i] = Scaled(parameter.full_name, vehicle).value_or(truth[i]);
  }
  return truth;
}

}  // namespace odmc
