#include "odmc/model/effect.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "odmc/text/format.h"

namespace odmc {

RotorState RotorState::Steady(const RotorVector& speed_rad_s) {
  RotorState state;
  state.speed = speed_rad_s;
  state.speed_squared = speed_rad_s.array().square().matrix();
  state.acceleration = RotorVector::Zero(speed_rad_s.size());
  state.speed_squared_rate = RotorVector::Zero(speed_rad_s.size());
  return state;
}

BodyProperties BodyProperties::Nominal(const Vehicle& vehicle) {
  BodyProperties body;
  body.mass = vehicle.mass_kg;
  body.I_BBcm_B = vehicle.inertia_kg_m2.asDiagonal();
  body.g_W = Eigen::Vector3d(0.0, 0.0, -vehicle.gravity_m_s2);
  body.p_BS = vehicle.odometry.p_BS;
  body.R_BS = vehicle.odometry.q_BS.toRotationMatrix();
  if (vehicle.imu) {
    body.p_BI = vehicle.imu->p_BS;
    body.R_BI = vehicle.imu->q_BS.toRotationMatrix();
  }
  return body;
}

Effect::Effect(const Vehicle& vehicle, EffectDescription description,
               std::vector<ParameterSpec> parameters, std::vector<std::string> borrowed)
    : vehicle_(vehicle),
      description_(std::move(description)),
      parameters_(std::move(parameters)),
      borrowed_(std::move(borrowed)) {
  assert(num_values() <= kMaxEffectParameters);
}

void Effect::AddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                       WrenchJacobians* J) const {
  assert(values.size() == num_values());
  DoAddWrench(state, values, wrench, J);
}

void Effect::Shape(double time_s, const ParameterValues& values, BodyProperties* body,
                   BodyPropertyJacobian* J) const {
  assert(values.size() == num_values());
  DoShapeAt(time_s, values, body, J);
}

std::string Effect::manoeuvre(size_t /*k*/) const {
  return "quicker and faster, in all directions";
}

std::vector<EffectTrial> Effect::Trials(const FlownRange& /*flown*/, bool /*fits_thrust*/) const {
  return {EffectTrial()};
}

std::vector<DerivedFigure> Effect::DerivedFigures(const Eigen::VectorXd& /*own*/) const {
  return {};
}

Eigen::VectorXd Effect::Draw(const NormalNumbers& normal) const {
  Eigen::VectorXd values(static_cast<Eigen::Index>(parameters_.size()));
  for (size_t i = 0; i < parameters_.size(); ++i) {
    const ParameterSpec& spec = parameters_[i];
    double& value = values[static_cast<Eigen::Index>(i)];
    value = spec.prior_value;
    if (spec.frozen_by_default) continue;
    const double size = spec.prior_sigma * (0.3 + 0.4 * std::abs(normal()));
    const double sign = spec.sign == PhysicalSign::kPositive   ? 1.0
                        : spec.sign == PhysicalSign::kNegative ? -1.0
                        : normal() > 0.0                       ? 1.0
                                                               : -1.0;
    value = sign * size;
  }
  return values;
}

void Effect::Place(double /*lowest_m*/, Eigen::VectorXd* /*values*/) const {}

void Effect::DoAddWrench(const FlightState& /*state*/, const ParameterValues& /*values*/,
                         Wrench* /*wrench*/, WrenchJacobians* /*J*/) const {}

void Effect::DoShape(const ParameterValues& /*values*/, BodyProperties* /*body*/,
                     BodyPropertyJacobian* /*J*/) const {}

void Effect::DoShapeAt(double /*time_s*/, const ParameterValues& values, BodyProperties* body,
                       BodyPropertyJacobian* J) const {
  DoShape(values, body, J);
}

void EffectRegistry::Add(const std::string& name, Factory factory) {
  if (Has(name)) throw std::invalid_argument("effect '" + name + "' is registered twice");
  names_.push_back(name);
  factories_.push_back(std::move(factory));
}

bool EffectRegistry::Has(const std::string& name) const {
  return std::find(names_.begin(), names_.end(), name) != names_.end();
}

std::unique_ptr<Effect> EffectRegistry::Make(const std::string& name,
                                             const Vehicle& vehicle) const {
  const auto it = std::find(names_.begin(), names_.end(), name);
  if (it == names_.end()) {
    throw std::invalid_argument("unknown effect '" + name + "'; known are: " + Listed(names_));
  }
  return factories_[it - names_.begin()](vehicle);
}

EffectRegistry& EffectRegistry::Shared() {
  static EffectRegistry registry = [] {
    EffectRegistry r;
    RegisterAllEffects(&r);
    return r;
  }();
  return registry;
}

const EffectRegistry& EffectRegistry::Default() { return Shared(); }

void EffectRegistry::Extend(const std::string& name, Factory factory) {
  Shared().Add(name, std::move(factory));
}

}  // namespace odmc
