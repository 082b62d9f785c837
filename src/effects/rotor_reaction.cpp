#include "odmc/effects/effects.h"
#include "rotor_air.h"

namespace odmc {
namespace {

/// Rotors speeding up push back: τ = J_r Σ s dΩ/dt e3.              model.md 12.7, Eq. (M35)
class RotorReaction final : public Effect {
 public:
  explicit RotorReaction(const Vehicle& vehicle)
      : Effect(vehicle,
               {"rotor_reaction", "Reaction to rotor acceleration", "tau = J_r sum(s dOmega/dt) e3",
                "model.md 12.7",
                "shares a scale with k_m and I_z; needs rotor speeds that change quickly", true},
               {RotorInertiaSpec(vehicle)}) {}

 private:
  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    AddRotorMomentum(state, vehicle(), values[0], 0, false, true, wrench, J);
  }
};

}  // namespace

std::unique_ptr<Effect> MakeRotorReaction(const Vehicle& vehicle) {
  return std::make_unique<RotorReaction>(vehicle);
}

}  // namespace odmc
