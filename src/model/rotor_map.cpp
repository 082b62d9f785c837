#include "odmc/model/rotor_map.h"

namespace odmc {
namespace {

constexpr double kProbe = 1e6;       // (rad/s)²
constexpr double kFarUp_m = 1000.0;  // no ground effect

Eigen::Vector4d WrenchAtRest(const DynamicModel& model, const ModelValues& values,
                             const BodyProperties& properties, const RotorVector& squared_speed) {
  FlightState state;
  state.p_WB.z() = kFarUp_m;
  state.rotors = RotorState::Steady(squared_speed.cwiseSqrt());
  Eigen::Vector3d f_B, tau_Bcm_B;
  model.EvaluateWrench(state, values, properties.p_BBcm, &f_B, &tau_Bcm_B);
  return {f_B.z(), tau_Bcm_B.x(), tau_Bcm_B.y(), tau_Bcm_B.z()};
}

}  // namespace

RotorMap RotorMapAtRest(const DynamicModel& model, const ModelValues& values,
                        const BodyProperties& properties) {
  const int num_rotors = model.vehicle().num_rotors();
  const Eigen::Vector4d still =
      WrenchAtRest(model, values, properties, RotorVector::Zero(num_rotors));
  RotorMap map(4, num_rotors);
  for (int j = 0; j < num_rotors; ++j) {
    RotorVector squared = RotorVector::Zero(num_rotors);
    squared[j] = kProbe;
    map.col(j) = (WrenchAtRest(model, values, properties, squared) - still) / kProbe;
  }
  return map;
}

}  // namespace odmc
