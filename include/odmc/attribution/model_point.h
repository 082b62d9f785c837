#pragma once

#include <map>
#include <string>
#include <vector>

#include "odmc/attribution/candidates.h"
#include "odmc/attribution/ranked_effect.h"
#include "odmc/attribution/residual.h"

namespace odmc {

/// A model with the values about which it is looked at.
struct ModelPoint {
  Vehicle vehicle;
  std::map<std::string, double> values;  ///< by full name
  /// Of several flights, what each has in the place of these: direction of gravity, wind.
  std::vector<std::map<std::string, double>> own = {};
  /// By how much a parameter of the vehicle differs from flight to flight (standard deviation).
  std::map<std::string, double> scatter = {};

  /// The point of one of them.
  ModelPoint OfFlight(size_t flight) const;
};

/// The vehicle with a candidate added, its settings frozen, what it frees estimated.
Vehicle VehicleWith(const Vehicle& vehicle, const EffectCandidate& candidate);
/// The same with an effect that was found, and its settings.
Vehicle VehicleWith(const Vehicle& vehicle, const RankedEffect& effect);

/// A vehicle as attribution asks about it: what is estimated has the priors of the vehicle file
/// again, and starts there; of effects the file does not list, the values stay. The sigmas of an
/// earlier estimate (`parameters.yaml`) hold under its model, and whether that lacks something is
/// the question: a viscous torque that took the place of a hub moment, known to 15 %, would forbid
/// the hub moment. What is frozen stays, as a thrust coefficient that is known.
Vehicle WithPriorsOf(const Vehicle& file_vehicle, const Vehicle& vehicle);

/// A model as the online estimator found it, inertia as the vehicle file has it: online it takes
/// the noise of the rotor speeds, and what else acts, for its own.
ModelPoint ModelPointOf(const DynamicModel& model, const ModelValues& values);

/// The vehicle with what was found. Everything starts where the fit (which has not seen what is
/// held out) has brought it: what multiplies each other, as wind and drag, has more than one
/// valley.
/// @param vehicle with the declared effects
/// @param known of other parameters, by full name: value and sigma
Vehicle VehicleWithEffects(const Vehicle& vehicle, const ModelPoint& point,
                           const std::vector<RankedEffect>& effects,
                           const std::map<std::string, ParameterSetting>& known = {});

/// The model's initial values, but what is known.
ModelValues ValuesOf(const DynamicModel& model, const std::map<std::string, double>& known);

}  // namespace odmc
