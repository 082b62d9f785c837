#include "known_parameters.h"

#include "odmc/model/effect.h"

namespace odmc {

std::map<std::string, ParameterSpec> KnownParameters(const Vehicle& vehicle) {
  std::map<std::string, ParameterSpec> specs;
  for (const std::string& name : EffectRegistry::Default().names()) {
    const auto effect = EffectRegistry::Default().Make(name, vehicle);
    for (const ParameterSpec& spec : effect->parameters()) specs[name + "." + spec.name] = spec;
  }
  return specs;
}

std::vector<std::string> NamesOf(const std::map<std::string, ParameterSpec>& specs) {
  std::vector<std::string> names;
  for (const auto& [name, spec] : specs) names.push_back(name);
  return names;
}

}  // namespace odmc
