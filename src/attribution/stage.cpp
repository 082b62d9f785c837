#include "odmc/attribution/stage.h"

#include <algorithm>
#include <optional>

namespace odmc {

Stage Stage::OfFlight(size_t flight) const {
  Stage one{vehicle, values};
  if (flight < own.size()) {
    for (const auto& [name, value] : own[flight]) one.values[name] = value;
  }
  return one;
}

Vehicle With(const Vehicle& vehicle, const Candidate& candidate) {
  Vehicle extended = vehicle;
  extended.effects.push_back(candidate.effect);
  for (const auto& [name, value] : candidate.settings) {
    extended.parameters[name].value = value;
    extended.parameters[name].estimated = false;
  }
  return extended;
}

Vehicle WithPriorsOf(const Vehicle& file_vehicle, const Vehicle& vehicle) {
  Vehicle asked = vehicle;
  const DynamicModel model(vehicle, vehicle.effects);
  for (const ModelParameter& p : model.parameters()) {
    const auto setting = asked.parameters.find(p.full_name);
    if (!p.estimated || setting == asked.parameters.end()) continue;
    const auto filed = file_vehicle.parameters.find(p.full_name);
    const bool has = filed != file_vehicle.parameters.end();
    const auto& declared = file_vehicle.effects;
    setting->second.sigma = has ? filed->second.sigma : std::nullopt;
    if (std::count(declared.begin(), declared.end(), p.effect) > 0) {
      setting->second.value = has ? filed->second.value : std::nullopt;
    }
  }
  return asked;
}

Stage StageOf(const DynamicModel& model, const ModelValues& values) {
  Stage stage;
  stage.vehicle = model.vehicle();
  for (int i = 0; i < model.num_parameters(); ++i) {
    const ModelParameter& p = model.parameters()[i];
    stage.values[p.full_name] = p.effect == "inertia" ? p.spec.prior_value : values[i];
  }
  return stage;
}

ModelValues ValuesOf(const DynamicModel& model, const std::map<std::string, double>& known) {
  ModelValues values = model.InitialValues();
  for (int i = 0; i < model.num_parameters(); ++i) {
    const auto it = known.find(model.parameters()[i].full_name);
    if (it != known.end()) values[i] = it->second;
  }
  return values;
}

}  // namespace odmc
