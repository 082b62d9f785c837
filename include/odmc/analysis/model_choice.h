#pragma once

#include <optional>
#include <string>
#include <vector>

#include "odmc/model/dynamic_model.h"
#include "odmc/model/parameter_set.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// Which model to build, beyond what the vehicle file says.
struct ModelChoice {
  std::optional<ParameterSet> parameters;  ///< effects, start values, priors, states
  std::vector<std::string> effects;        ///< replaces the list where not empty
  std::vector<std::string> without;        ///< taken off the list
  std::vector<std::string> free;           ///< to estimate, by full name or effect
  std::vector<std::string> freeze;         ///< to hold, by full name or effect
};

/// The vehicle with the choice in it, its effects in Vehicle::effects. Extrinsics that the vehicle
/// wants estimated join the list unless `without` names them; settings of effects that are not on
/// the list are ignored.
/// @throws std::invalid_argument naming what the model has not
Vehicle Configure(const Vehicle& file_vehicle, const ModelChoice& choice);

/// True if `full_name` is `pattern`, or a parameter of the effect `pattern`.
bool MatchesParameter(const std::string& full_name, const std::string& pattern);

/// Why the model's mass and thrust coefficient cannot both be estimated, empty if they can: a
/// flight shows their ratio, unless the mass changes within it, since k_f is seen before. A change
/// from the recording's start on acts over the whole flight.
std::string MassBesideThrust(const DynamicModel& model);

/// A set that states the model at exact values: sigma 0, all frozen. The simulator's truth.
ParameterSet ExactParameters(const DynamicModel& model, const ModelValues& values);

/// Adds white Gaussian noise (per axis) to every odometry position; the same seed, the same noise.
void AddPositionNoise(double sigma_m, int seed, FlightLog* log);

}  // namespace odmc
