#include "odmc/effects/effects.h"

namespace odmc {

void RegisterAllEffects(EffectRegistry* registry) {
#define ODMC_REGISTER_EFFECT(name, make) registry->Add(#name, make);
  ODMC_EFFECTS(ODMC_REGISTER_EFFECT)
#undef ODMC_REGISTER_EFFECT
}

const std::vector<std::string>& DefaultEffects() {
  static const std::vector<std::string> effects = {
      "thrust", "rotor_torque",      "drag",    "viscous_torque",
      "hvt",    "centre_of_gravity", "inertia", "gravity"};
  return effects;
}

}  // namespace odmc
