#include "odmc/sim/hanging_load.h"

namespace odmc {

HangingLoad::HangingLoad(const DynamicModel& model, const ModelValues& values) {
  const std::optional<PendulumParameters>& own = model.pendulum();
  if (!own) return;
  p_BP_ = values.segment<3>(own->place);
  pendulum_.emplace(values[own->length], values[own->damping], model.vehicle().gravity_m_s2,
                    values.segment<4>(own->swing));
}

void HangingLoad::Swing(const RigidBody& body, double time_s, const RotorVector& speed_cmd,
                        const BodyWrench& external, double step_s, RigidBodyState* state) {
  if (!pendulum_) return;
  // The cable pulls with the acceleration of a step ago, at most a millisecond old.
  const BodyWrench total = body.WrenchOf(body.FlightStateOf(time_s, *state, speed_cmd)) + external;
  const RigidBodyRate rate = body.RateOf(*state, total);
  const Eigen::Vector3d& w_B = state->w_WB_B;
  const Eigen::Vector3d acceleration_W =
      rate.d_v_WB +
      state->q_WB * Eigen::Vector3d(rate.d_w_WB_B.cross(p_BP_) + w_B.cross(w_B.cross(p_BP_)));
  state->load_pull_W = pendulum_->Pull(acceleration_W);
  pendulum_->Advance(acceleration_W, step_s);
}

}  // namespace odmc
