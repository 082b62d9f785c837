#include "odmc/model/parameter_set.h"

#include <cmath>

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
    if (p.sigma > 0.0) setting.sigma = std::hypot(p.sigma, p.scatter);
    setting.estimated = p.estimated;
  }
}

void AddTrust(const std::vector<Finding>& findings, ParameterSet* set) {
  const std::vector<std::string> reasons = TrustReasons(findings);
  set->provenance["trust"] = Name(TrustOf(findings));
  set->provenance.erase("trust_reason");
  if (!reasons.empty()) set->provenance["trust_reason"] = reasons.front();
}

std::string ObjectionTo(const ParameterSet& set) {
  const auto trust = set.provenance.find("trust");
  if (trust == set.provenance.end() || trust->second == Name(Trust::kGood)) return "";
  const auto reason = set.provenance.find("trust_reason");
  const std::string because = reason == set.provenance.end() ? "" : ": " + reason->second;
  return "its trust is " + trust->second + because;
}

}  // namespace odmc
