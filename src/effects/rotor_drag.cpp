#include "odmc/effects/effects.h"
#include "rotor_air.h"

namespace odmc {
namespace {

/// Induced and flapping drag of each rotor, in its plane: f_j = -k_d Ω_j Π u_j at hub j.
///                                                                      model.md 12.1
class RotorDrag final : public Effect {
 public:
  explicit RotorDrag(const Vehicle& vehicle)
      : Effect(vehicle,
               {"rotor_drag", "Rotor drag",
                "f_j = -k_d Omega_j (u_jx, u_jy, 0) at hub j, u_j = v_AB_B + w x r_j",
                "model.md 12.1; Martin and Salaun 2010; Kai et al. 2017",
                "one with linear drag while the rotors' speed hardly changes; acts in the hub "
                "plane"},
               {HubDampingSpec("k_d", "in-plane drag per rotor speed and air speed", vehicle)}) {}

 private:
  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    AddHubDamping(state, vehicle(), values[0], {1.0, 1.0, 0.0}, 0, wrench, J);
  }
};

}  // namespace

std::unique_ptr<Effect> MakeRotorDrag(const Vehicle& vehicle) {
  return std::make_unique<RotorDrag>(vehicle);
}

}  // namespace odmc
