#include "odmc/effects/effects.h"
#include "odmc/math/so3.h"
#include "rotor_air.h"

namespace odmc {
namespace {

/// Induced and flapping drag of each rotor, in its plane: f_j = -k_d Ω_j Π u_j, a height above
/// hub j: where on the rotor it acts differs from vehicle to vehicle, and its moment with it.
///                                                                      model.md 12.1
class RotorDrag final : public Effect {
 public:
  explicit RotorDrag(const Vehicle& vehicle)
      : Effect(vehicle,
               {"rotor_drag", "Rotor drag",
                "f_j = -k_d Omega_j (u_jx, u_jy, 0) at hub j + height e3, u_j = v_AB_B + w x r_j",
                "model.md 12.1; Martin and Salaun 2010; Kai et al. 2017",
                "one with linear drag while the rotors' speed hardly changes; acts in the hub "
                "plane"},
               {HubDampingSpec("k_d", "in-plane drag per rotor speed and air speed", vehicle),
                {"height", "m", "of the point it acts at above the hubs", 0.0,
                 0.2 * vehicle.ArmLength(), 0.1 * vehicle.ArmLength()}}) {}

 private:
  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    AddHubDamping(state, vehicle(), values[0], {1.0, 1.0, 0.0}, 0, wrench, J);
    // The couple of moving all of it up by `height`.
    const Eigen::Vector3d e3 = Eigen::Vector3d::UnitZ();
    Eigen::Vector3d force = Eigen::Vector3d::Zero();  // per k_d
    for (int j = 0; j < vehicle().num_rotors(); ++j) {
      const Rotor& rotor = vehicle().rotors[j];
      const Eigen::Vector3d slope = -state.rotors.speed[j] * Eigen::Vector3d(1.0, 1.0, 0.0);
      force += slope.cwiseProduct(HubAirVelocity(state, rotor));
      if (J == nullptr) continue;
      const Eigen::Matrix3d d_air =
          values[0] * values[1] * Hat(e3) * Eigen::Matrix3d(slope.asDiagonal());
      J->AddCouple(kColumnAirVelocity, d_air);
      J->AddCouple(kColumnAngularRate, TimesHat(d_air, -rotor.p_BP));
    }
    wrench->AddCouple(values[0] * values[1] * e3.cross(force));
    if (J == nullptr) return;
    J->AddCoupleParameter(0, values[1] * e3.cross(force));
    J->AddCoupleParameter(1, values[0] * e3.cross(force));
  }
};

}  // namespace

std::unique_ptr<Effect> MakeRotorDrag(const Vehicle& vehicle) {
  return std::make_unique<RotorDrag>(vehicle);
}

}  // namespace odmc
