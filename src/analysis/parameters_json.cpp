#include "odmc/analysis/parameters_json.h"

#include "odmc/analysis/calibration.h"
#include "odmc/analysis/json.h"

namespace odmc {
namespace {

using Json = nlohmann::ordered_json;

double SigmaOf(const ParameterEstimate& p) { return p.estimated ? p.sigma : 0.0; }

Json ParameterJson(const ParameterEstimate& p) {
  return {{"value", JsonNumber(p.value)},
          {"sigma", JsonNumber(SigmaOf(p))},
          {"unit", p.unit},
          {"state", p.estimated ? "estimated" : "frozen"}};
}

}  // namespace

Json ParametersJson(const std::vector<ParameterEstimate>& parameters) {
  Json json = Json::object();
  for (const ParameterEstimate& p : parameters) json[p.full_name] = ParameterJson(p);
  return json;
}

Json ParametersJson(const std::vector<ParameterEstimate>& parameters, const DynamicModel& model) {
  Json json = ParametersJson(parameters);
  for (const ParameterEstimate& p : parameters) {
    const int k = model.IndexOf(p.full_name);
    json[p.full_name]["observable"] = p.observable;
    json[p.full_name]["sign_unphysical"] =
        k >= 0 && IsSignUnphysical(model.parameters()[k].spec, p.value, SigmaOf(p));
  }
  return json;
}

}  // namespace odmc
