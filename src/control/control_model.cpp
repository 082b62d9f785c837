#include "odmc/control/control_model.h"

#include <algorithm>
#include <utility>

namespace odmc {
namespace {

// Without these there is nothing to control with.
bool IsNeeded(const std::string& effect) {
  static const std::vector<std::string> needed = {"thrust", "rotor_torque", "inertia",
                                                  "odometry_extrinsics", "imu_extrinsics"};
  return std::find(needed.begin(), needed.end(), effect) != needed.end();
}

}  // namespace

bool CompensatedEffects::Has(const std::string& effect) const {
  if (effect == "drag") return drag;
  if (effect == "hvt") return hvt;
  if (effect == "viscous_torque") return viscous_torque;
  if (effect == "centre_of_gravity") return centre_of_gravity;
  if (effect == "gravity") return gravity;
  return others || IsNeeded(effect);
}

ControlModel::ControlModel(std::shared_ptr<const DynamicModel> model,
                           const CompensatedEffects& compensation)
    : model_(std::move(model)) {
  for (const ModelParameter& p : model_->parameters()) {
    // A size that is positive by nature (a length, a time constant) can't be zero.
    const bool can_be_zero = p.spec.transform == ParameterTransform::kLinear;
    zeroed_.push_back(can_be_zero && !compensation.Has(p.effect));
  }
  SetValues(model_->InitialValues());
}

void ControlModel::SetValues(const ModelValues& values) {
  values_ = values;
  for (Eigen::Index i = 0; i < values_.size(); ++i) {
    if (zeroed_[i]) values_[i] = 0.0;
  }
  properties_ = model_->Properties(values_);
  map_ = RotorMapAtRest(*model_, values_, properties_);
}

BodyWrench ControlModel::AirWrench(const Eigen::Vector3d& p_WB, const Eigen::Matrix3d& R_WB,
                                   const Eigen::Vector3d& v_WB, const Eigen::Vector3d& w_WB_B,
                                   const RotorVector& rotor_speed) const {
  FlightState state;
  state.p_WB = p_WB;
  state.R_WB = R_WB;
  state.v_AB_B = R_WB.transpose() * (v_WB - properties_.wind_W);
  state.w_WB_B = w_WB_B;
  state.rotors = RotorState::Steady(rotor_speed);
  BodyWrench wrench;
  model_->EvaluateWrench(state, values_, properties_.p_BBcm, &wrench.f_B, &wrench.tau_Bcm_B);
  const Eigen::Vector4d rotors = map_ * state.rotors.speed_squared;
  wrench.f_B.z() -= rotors[0];
  wrench.tau_Bcm_B -= rotors.tail<3>();
  return wrench;
}

}  // namespace odmc
