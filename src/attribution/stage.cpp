#include "odmc/attribution/stage.h"

#include <cmath>

#include "odmc/attribution/instrumented_inertia.h"

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

Stage StageOf(const DynamicModel& model, const ModelValues& values, const ResidualModel& residual) {
  constexpr double kLeastSigma = 0.02;  // of itself: what the balance leaves out
  Stage stage;
  stage.vehicle = model.vehicle();
  for (int i = 0; i < model.num_parameters(); ++i) {
    stage.values[model.parameters()[i].full_name] = values[i];
  }
  const int k_f = model.IndexOf("thrust.k_f"), k_m = model.IndexOf("rotor_torque.k_m");
  std::array<std::optional<InertiaEstimate>, 3> seen;
  if (!getenv("NOIV") && residual.num_channels() == kNumChannels && k_f >= 0 && k_m >= 0) {
    seen = InstrumentedInertia(residual.flight(), residual.file_vehicle(), values[k_f], values[k_m]);
  }
  int axis = 0;
  for (const ModelParameter& p : model.parameters()) {
    if (p.effect != "inertia") continue;
    const std::optional<InertiaEstimate>& found = seen[axis++];
    if (!p.estimated) continue;
    double value = p.spec.prior_value, left = p.spec.prior_sigma;
    if (found) {
      const double sigma = std::hypot(found->sigma_kg_m2, kLeastSigma * found->value_kg_m2);
      const double weight = std::pow(sigma, -2), prior = std::pow(p.spec.prior_sigma, -2);
      value = (weight * found->value_kg_m2 + prior * p.spec.prior_value) / (weight + prior);
      left = 1.0 / std::sqrt(weight + prior);
    }
    stage.values[p.full_name] = value;
    stage.vehicle.parameters[p.full_name].value = value;
    stage.vehicle.parameters[p.full_name].sigma = left;
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
