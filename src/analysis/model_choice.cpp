#include "odmc/analysis/model_choice.h"

#include <algorithm>
#include <stdexcept>

#include "odmc/math/gaussian.h"

namespace odmc {
namespace {

constexpr int kPositionNoiseStream = 101;  // apart from the simulator's

bool Lists(const std::vector<std::string>& names, const std::string& name) {
  return std::find(names.begin(), names.end(), name) != names.end();
}

void SetStates(const DynamicModel& model, const std::vector<std::string>& patterns, bool estimated,
               Vehicle* vehicle) {
  for (const std::string& pattern : patterns) {
    bool found = false;
    for (const ModelParameter& p : model.parameters()) {
      if (!MatchesParameter(p.full_name, pattern)) continue;
      vehicle->parameters[p.full_name].estimated = estimated;
      found = true;
    }
    if (!found) {
      throw std::invalid_argument("cannot " + std::string(estimated ? "free" : "freeze") + " '" +
                                  pattern + "': the model has no such parameter or effect");
    }
  }
}

}  // namespace

bool MatchesParameter(const std::string& full_name, const std::string& pattern) {
  return full_name == pattern || full_name.rfind(pattern + ".", 0) == 0;
}

Vehicle Configure(const Vehicle& file_vehicle, const ModelChoice& choice) {
  Vehicle vehicle = file_vehicle;
  if (choice.parameters) ApplyParameters(*choice.parameters, &vehicle);
  if (!choice.effects.empty()) vehicle.effects = choice.effects;
  if (vehicle.odometry.estimate && !Lists(vehicle.effects, "odometry_extrinsics")) {
    vehicle.effects.push_back("odometry_extrinsics");
  }
  if (vehicle.imu && vehicle.imu->estimate && !Lists(vehicle.effects, "imu_extrinsics")) {
    vehicle.effects.push_back("imu_extrinsics");
  }
  vehicle.effects.erase(
      std::remove_if(vehicle.effects.begin(), vehicle.effects.end(),
                     [&](const std::string& name) { return Lists(choice.without, name); }),
      vehicle.effects.end());
  const DynamicModel model(vehicle, vehicle.effects);
  SetStates(model, choice.free, true, &vehicle);
  SetStates(model, choice.freeze, false, &vehicle);
  return vehicle;
}

std::string MassBesideThrust(const DynamicModel& model) {
  const auto is_estimated = [&model](const std::string& name) {
    const int i = model.IndexOf(name);
    return i >= 0 && model.parameters()[i].estimated;
  };
  if (!is_estimated("thrust.k_f")) return "";
  const ModelValues values = model.InitialValues();
  for (int i = 0; i < model.num_effects(); ++i) {
    const Effect& effect = model.effect(i);
    if (effect.added_mass_parameter().empty() || effect.onset_parameter().empty()) continue;
    const std::string mass = effect.name() + "." + effect.added_mass_parameter();
    const std::string onset = effect.name() + "." + effect.onset_parameter();
    if (!is_estimated(mass) || values[model.IndexOf(onset)] > 0.0) continue;
    return mass + " and thrust.k_f cannot both be estimated where the mass holds over the whole " +
           "flight, which shows their ratio: freeze one of them, or set " + onset +
           " to when the mass changes";
  }
  return "";
}

ParameterSet ExactParameters(const DynamicModel& model, const ModelValues& values) {
  ParameterSet set;
  set.effects = model.effect_names();
  for (int i = 0; i < model.num_parameters(); ++i) {
    const ModelParameter& p = model.parameters()[i];
    set.parameters.push_back({p.full_name, p.spec.unit, values[i], 0.0, false, false});
  }
  return set;
}

void AddPositionNoise(double sigma_m, int seed, FlightLog* log) {
  Gaussian gaussian(seed, kPositionNoiseStream);
  for (OdometrySample& sample : log->odometry) sample.p_WS += sigma_m * gaussian.Next3();
}

}  // namespace odmc
