#include "odmc/model/parameter_set.h"

namespace odmc {

const ParameterEstimate* ParameterSet::Find(const std::string& full_name) const {
  for (const ParameterEstimate& p : parameters) {
    if (p.full_name == full_name) return &p;
  }
  return nullptr;
}

void ApplyParameters(const ParameterSet& set, Vehicle* vehicle) {
  vehicle->effects = set.effects;
  for (const ParameterEstimate& p : set.parameters) {
    ParameterSetting& setting = vehicle->parameters[p.full_name];
    setting.value = p.value;
    if (p.sigma > 0.0) setting.sigma = p.sigma;
    setting.estimated = p.estimated;
  }
}

}  // namespace odmc
