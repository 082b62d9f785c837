#include "odmc/attribution/stage.h"

namespace odmc {

Vehicle With(const Vehicle& vehicle, const Candidate& candidate) {
  Vehicle extended = vehicle;
  extended.effects.push_back(candidate.effect);
  for (const auto& [name, value] : candidate.settings) {
    extended.parameters[name].value = value;
    extended.parameters[name].estimated = false;
  }
  return extended;
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
