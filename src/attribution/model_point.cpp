#include "odmc/attribution/model_point.h"

#include <algorithm>
#include <optional>

#include "odmc/model/plausibility.h"

namespace odmc {
namespace {

/// What moves by itself is started near what the regression found of it, and so is its place. They
/// are no evidence for the effect, and the first second of flight alone would lead the online
/// estimate astray.
void HoldInitialState(const RankedEffect& effect, Vehicle* vehicle) {
  constexpr double kSigmas = 1.0;  // of the regression's
  const DynamicModel model(*vehicle, vehicle->effects);
  const auto spec = [&model](const ParameterEstimate& p) -> const ParameterSpec& {
    return model.parameters()[model.IndexOf(p.full_name)].spec;
  };
  const bool moves = std::any_of(effect.parameters.begin(), effect.parameters.end(),
                                 [&](const ParameterEstimate& p) { return spec(p).initial_state; });
  for (const ParameterEstimate& p : effect.parameters) {
    if (!moves || !p.estimated || spec(p).sign != PhysicalSign::kAny) continue;
    vehicle->parameters[p.full_name].sigma = std::min(kSigmas * p.sigma, spec(p).prior_sigma);
  }
}

/// What a linear fit finds may be what no vehicle of this geometry has: then the value stays.
void SetPlausible(double value, const ModelParameter& parameter, const Vehicle& vehicle,
                  ParameterSetting* setting) {
  ParameterSetting fitted;
  fitted.value = value;
  if (!DoubtOf(parameter.full_name, parameter.spec, fitted, vehicle).key.empty()) return;
  setting->value = value;
}

}  // namespace

ModelPoint ModelPoint::OfFlight(size_t flight) const {
  ModelPoint one{vehicle, values, {}, scatter};
  if (flight < own.size()) {
    for (const auto& [name, value] : own[flight]) one.values[name] = value;
  }
  return one;
}

Vehicle VehicleWith(const Vehicle& vehicle, const EffectCandidate& candidate) {
  Vehicle extended = vehicle;
  extended.effects.push_back(candidate.effect);
  for (const auto& [name, value] : candidate.settings) {
    extended.parameters[name].value = value;
    extended.parameters[name].estimated = false;
  }
  for (const std::string& name : candidate.freed) extended.parameters[name].estimated = true;
  for (const std::string& name : candidate.fitted) extended.parameters[name].estimated = true;
  return extended;
}

Vehicle VehicleWith(const Vehicle& vehicle, const RankedEffect& effect) {
  EffectCandidate candidate;
  candidate.effect = effect.name;
  candidate.settings = effect.settings;
  candidate.freed = effect.freed;
  return VehicleWith(vehicle, candidate);
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

ModelPoint ModelPointOf(const DynamicModel& model, const ModelValues& values) {
  ModelPoint point;
  point.vehicle = model.vehicle();
  for (int i = 0; i < model.num_parameters(); ++i) {
    const ModelParameter& p = model.parameters()[i];
    point.values[p.full_name] = p.effect == "inertia" ? p.spec.prior_value : values[i];
  }
  return point;
}

Vehicle VehicleWithEffects(const Vehicle& vehicle, const ModelPoint& point,
                           const std::vector<RankedEffect>& effects,
                           const std::map<std::string, ParameterSetting>& known) {
  Vehicle extended = vehicle;
  const DynamicModel declared(vehicle, vehicle.effects);
  for (const ModelParameter& p : declared.parameters()) {
    if (!p.estimated || p.effect == "inertia") continue;
    SetPlausible(point.values.at(p.full_name), p, vehicle, &extended.parameters[p.full_name]);
    extended.parameters[p.full_name].sigma = p.spec.prior_sigma;
  }
  for (const RankedEffect& effect : effects) {
    extended = VehicleWith(extended, effect);
    for (const ParameterEstimate& p : effect.parameters) {
      if (p.estimated) extended.parameters[p.full_name].value = p.value;
    }
    HoldInitialState(effect, &extended);
  }
  for (const auto& [name, setting] : known) {
    ParameterSetting& of = extended.parameters[name];
    const int k = declared.IndexOf(name);
    if (k >= 0 && setting.value) {
      SetPlausible(*setting.value, declared.parameters()[k], vehicle, &of);
    } else {
      of.value = setting.value;
    }
    of.sigma = of.sigma ? std::min(*of.sigma, *setting.sigma) : *setting.sigma;
  }
  return extended;
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
