#include "rotor_air.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "odmc/effects/effects.h"
#include "odmc/math/so3.h"

namespace odmc {

using Eigen::Matrix3d;
using Eigen::Vector3d;

double HoverSpeed(const Vehicle& vehicle) {
  const auto it = vehicle.parameters.find("thrust.k_f");
  const double k_f = it != vehicle.parameters.end() && it->second.value && *it->second.value > 0.0
                         ? *it->second.value
                         : MakeThrust(vehicle)->parameters().front().prior_value;
  const double per_rotor =
      vehicle.mass_kg * vehicle.gravity_m_s2 / std::max(1, vehicle.num_rotors());
  return std::sqrt(per_rotor / k_f);
}

double DiscArea(const Vehicle& vehicle) {
  double area = 0.0;
  for (const Rotor& rotor : vehicle.rotors) area += M_PI * rotor.radius_m * rotor.radius_m;
  return area;
}

double InflowSquaredPerThrust(const Rotor& rotor) {
  return 1.0 / (2.0 * kAirDensity * M_PI * rotor.radius_m * rotor.radius_m);
}

double HoverInflow(const Vehicle& vehicle) {
  const double thrust = vehicle.mass_kg * vehicle.gravity_m_s2 / std::max(1, vehicle.num_rotors());
  double least = std::numeric_limits<double>::infinity();
  for (const Rotor& rotor : vehicle.rotors) {
    least = std::min(least, std::sqrt(InflowSquaredPerThrust(rotor) * thrust));
  }
  return least;
}

std::vector<EffectTrial> FastTrials(const Vehicle& vehicle, const FlownRange& flown) {
  constexpr double kSecondOrder = 0.15;
  const double speed = HoverSpeed(vehicle);
  for (const Rotor& rotor : vehicle.rotors) {
    if (flown.speed_m_s > kSecondOrder * speed * rotor.radius_m) return {EffectTrial()};
  }
  return {};
}

Vector3d HubAirVelocity(const FlightState& state, const Rotor& rotor) {
  return state.v_AB_B + state.w_WB_B.cross(rotor.p_BP);
}

void AddHubForce(const Rotor& rotor, const Vector3d& force, const Matrix3d& d_air, Wrench* wrench,
                 WrenchJacobians* J) {
  wrench->AddForceAt(rotor.p_BP, force);
  if (J == nullptr) return;
  J->AddForceAt(rotor.p_BP, kColumnAirVelocity, d_air);
  J->AddForceAt(rotor.p_BP, kColumnAngularRate, TimesHat(d_air, -rotor.p_BP));
}

void AddHubDamping(const FlightState& state, const Vehicle& vehicle, double k,
                   const Vector3d& projection, int index, Wrench* wrench, WrenchJacobians* J) {
  for (int j = 0; j < vehicle.num_rotors(); ++j) {
    const Rotor& rotor = vehicle.rotors[j];
    const Vector3d slope = -state.rotors.speed[j] * projection;
    const Vector3d unit = slope.cwiseProduct(HubAirVelocity(state, rotor));
    AddHubForce(rotor, k * unit, (k * slope).asDiagonal(), wrench, J);
    if (J != nullptr) J->AddForceAtParameter(rotor.p_BP, index, unit);
  }
}

void AddHubLift(const FlightState& state, const Vehicle& vehicle, double k, int index,
                Wrench* wrench, WrenchJacobians* J) {
  for (const Rotor& rotor : vehicle.rotors) {
    const Vector3d u = HubAirVelocity(state, rotor);
    const Vector3d unit = 0.25 * u.head<2>().squaredNorm() * Vector3d::UnitZ();
    Matrix3d d_air = Matrix3d::Zero();
    d_air.row(2) << 0.5 * k * u.x(), 0.5 * k * u.y(), 0.0;
    AddHubForce(rotor, k * unit, d_air, wrench, J);
    if (J != nullptr) J->AddForceAtParameter(rotor.p_BP, index, unit);
  }
}

void AddRotorMomentum(const FlightState& state, const Vehicle& vehicle, double inertia, int index,
                      bool gyroscopic, bool reaction, Wrench* wrench, WrenchJacobians* J) {
  double speed = 0.0, acceleration = 0.0;
  for (int j = 0; j < vehicle.num_rotors(); ++j) {
    speed += vehicle.rotors[j].spin * state.rotors.speed[j];
    acceleration += vehicle.rotors[j].spin * state.rotors.acceleration[j];
  }
  const Vector3d e3 = Vector3d::UnitZ();
  Vector3d unit = Vector3d::Zero();
  if (gyroscopic) unit += speed * state.w_WB_B.cross(e3);
  if (reaction) unit += acceleration * e3;
  wrench->AddCouple(inertia * unit);
  if (J == nullptr) return;
  if (gyroscopic) J->AddCouple(kColumnAngularRate, -inertia * speed * Hat(e3));
  J->AddCoupleParameter(index, unit);
}

ParameterSpec HubDampingSpec(const std::string& name, const std::string& description,
                             const Vehicle& vehicle) {
  const double sum = std::max(1, vehicle.num_rotors()) * HoverSpeed(vehicle);
  return {name,
          "N s^2/m",
          description,
          0.0,
          vehicle.mass_kg / sum,
          0.3 * vehicle.mass_kg / sum,
          ParameterTransform::kLinear,
          PhysicalSign::kPositive};
}

ParameterSpec LiftSpec(const std::string& name, const std::string& description,
                       const Vehicle& vehicle) {
  return {name,
          "kg/m",
          description,
          0.0,
          0.05 * vehicle.mass_kg,
          0.01 * vehicle.mass_kg,
          ParameterTransform::kLinear,
          PhysicalSign::kPositive};
}

ParameterSpec WindSpec(const std::string& axis) {
  return {"w_" + axis, "m/s", "wind velocity, world " + axis, 0.0, 4.0, 1.0};
}

ParameterSpec RotorInertiaSpec(const Vehicle& vehicle) {
  // A blade pair of 2 % of the vehicle's mass per rotor, spread evenly over the radius.
  const double radius = vehicle.rotors.empty() ? 0.1 : vehicle.rotors.front().radius_m;
  const double guess = 0.01 * vehicle.mass_kg * radius * radius / 3.0;
  return {"J_r",
          "kg m^2",
          "inertia of one rotor about its axis, bell included",
          0.0,
          5.0 * guess,
          guess,
          ParameterTransform::kLinear,
          PhysicalSign::kPositive,
          false,
          {},
          {},
          false,
          true};
}

}  // namespace odmc
