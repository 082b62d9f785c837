#include "odmc/sim/hanging_load.h"

namespace odmc {

HangingLoad::HangingLoad(const DynamicModel& model, const ModelValues& values) {
  const std::optional<PendulumParameters>& own = model.pendulum();
  if (!own) return;
  p_BP_ = values.segment<3>(own->place);
  swing_ = values.segment<4>(own->swing);
  mass_ = model.vehicle().mass_kg;
  pendulum_.emplace(values[own->length], values[own->damping], model.vehicle().gravity_m_s2,
                    swing_);
}

void HangingLoad::Swing(const RigidBody& body, double time_s, const RotorVector& speed_cmd,
                        const BodyWrench& external, double step_s, RigidBodyState* state) {
  if (!pendulum_) return;
  // How the vehicle turns is of a step ago, at most a millisecond old.
  const BodyWrench total = body.WrenchOf(body.FlightStateOf(time_s, *state, speed_cmd)) + external;
  const RigidBodyRate rate = body.RateOf(*state, total);
  const Eigen::Vector3d& w_B = state->w_WB_B;
  const auto turning_W = [&](const Eigen::Vector3d& p_B) {
    return Eigen::Vector3d(state->q_WB * (rate.d_w_WB_B.cross(p_B) + w_B.cross(w_B.cross(p_B))));
  };
  // What the model knows nothing of accelerates the vehicle beyond the model's forces.
  state->load.cable_W = pendulum_->direction_W();
  state->load.own_m_s2 = pendulum_->Tension(turning_W(p_BP_ - body.properties().p_BBcm) +
                                            state->q_WB * external.f_B / mass_);
  state->load.swing = swing_;
  pendulum_->Advance(rate.d_v_WB + turning_W(p_BP_), step_s);
}

}  // namespace odmc
