#include "odmc/sim/truth_sample.h"

namespace odmc {

TruthSample TruthOf(const RigidBody& body, Stamp stamp, const RigidBodyState& state,
                    const RotorVector& speed_cmd, const BodyWrench& external) {
  const FlightState flight = body.FlightStateOf(ToSeconds(stamp), state, speed_cmd);
  const BodyWrench total = body.WrenchOf(flight) + external;
  TruthSample sample;
  sample.stamp = stamp;
  sample.p_WB = state.p_WB;
  sample.q_WB = state.q_WB;
  sample.v_WB = state.v_WB;
  sample.w_WB_B = state.w_WB_B;
  sample.dw_WB_B = body.RateOf(state, total).d_w_WB_B;
  sample.rotor_speed = state.rotor_speed;
  sample.rotor_speed_cmd = speed_cmd;
  sample.f_B = total.f_B;
  sample.tau_Bcm_B = total.tau_Bcm_B;
  sample.external_f_B = external.f_B;
  sample.external_tau_Bcm_B = external.tau_Bcm_B;
  return sample;
}

}  // namespace odmc
