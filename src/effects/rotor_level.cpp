#include "odmc/effects/effects.h"
#include "rotor_air.h"

namespace odmc {
namespace {

/// Everything a rotor does besides its static thrust and torque, at its hub. Meant in place of
/// drag, viscous_torque and hvt.                                        model.md 12.19, Eq. (M48)
class RotorLevel final : public Effect {
 public:
  explicit RotorLevel(const Vehicle& vehicle)
      : Effect(
            vehicle,
            {"rotor_level", "Unified rotor-level aerodynamics",
             "f_j = -Omega_j diag(k_d, k_d, k_z) u_j + k_h/4 (u_jx^2 + u_jy^2) e3 at hub j; tau = "
             "J_r (sum(s Omega) (w x e3) + sum(s dOmega/dt) e3)",
             "model.md 12.19, Eq. (M48)",
             "replaces drag, viscous_torque and hvt; lateral drag acts in the hub plane", true},
            {HubDampingSpec("k_d", "in-plane drag per rotor speed and air speed", vehicle),
             HubDampingSpec("k_z", "thrust loss per rotor speed and axial air speed", vehicle),
             LiftSpec("k_h", "extra thrust per squared horizontal air speed", vehicle),
             RotorInertiaSpec(vehicle)}) {}

  /// No candidate: it replaces other effects.
  std::vector<EffectTrial> Trials(const FlownRange&, bool) const override { return {}; }
  std::vector<std::string> shown_by() const override { return {}; }

 private:
  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    AddHubDamping(state, vehicle(), values[0], {1.0, 1.0, 0.0}, 0, wrench, J);
    AddHubDamping(state, vehicle(), values[1], Eigen::Vector3d::UnitZ(), 1, wrench, J);
    AddHubLift(state, vehicle(), values[2], 2, wrench, J);
    AddRotorMomentum(state, vehicle(), values[3], 3, true, true, wrench, J);
  }
};

}  // namespace

std::unique_ptr<Effect> MakeRotorLevel(const Vehicle& vehicle) {
  return std::make_unique<RotorLevel>(vehicle);
}

}  // namespace odmc
