#include "odmc/effects/effects.h"

namespace odmc {

void RegisterAllEffects(EffectRegistry* registry) {
#define ODMC_REGISTER_EFFECT(name, make) registry->Add(#name, make);
  ODMC_EFFECTS(ODMC_REGISTER_EFFECT)
#undef ODMC_REGISTER_EFFECT
}

}  // namespace odmc
