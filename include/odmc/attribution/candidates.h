#pragma once

#include <functional>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "odmc/analysis/flight_motion.h"
#include "odmc/attribution/ranked_effect.h"
#include "odmc/model/effect_traits.h"
#include "odmc/model/parameter_set.h"
#include "odmc/model/vehicle.h"

namespace odmc {

/// One way to try an effect: with these frozen parameters (full names).
struct EffectCandidate {
  std::string effect;
  std::map<std::string, double> settings;
  /// Where to linearize first, for parameters that do nothing at zero (a place of no mass).
  std::map<std::string, double> start = {};
  /// How its settings are refined; short names.
  std::vector<SettingRefinement> refinements = {};
  /// Parameters that are estimated although the model has them frozen; full names.
  std::vector<std::string> freed = {};
  /// Settings that are fitted from `start` on (EffectTrial::fitted); full names.
  std::set<std::string> fitted = {};
  /// Between which values parameters are linearized; full names.
  std::map<std::string, std::pair<double, double>> bounds = {};
  /// Of `start`, the effect's size: what its other parameters do is in proportion to it. Full name;
  /// empty where they do not wait for it.
  std::string size = {};
};

/// What a fit can walk through: the effect's name, with the signs to which bounds keep it
/// ("mass_change - +": less mass, above).
std::string ValleyNameOf(const EffectCandidate& candidate);

/// Every effect of the catalogue that `vehicle`'s model lacks and that may be added to it, with the
/// values to try for what cannot be estimated (Effect::Trials): when a mass changed, how long a
/// cable is, where the ground is.
std::vector<EffectCandidate> CandidatesFor(const Vehicle& vehicle, const FlightMotion& flight);

/// The same for several flights of one vehicle: every way that one of them offers. What begins at
/// some time of a flight is a candidate from each flight's start only.
std::vector<EffectCandidate> CandidatesFor(const Vehicle& vehicle,
                                           const std::vector<const FlightMotion*>& flights);

/// The candidates without those of some effects. @throws std::invalid_argument for a name that is
/// none
std::vector<EffectCandidate> WithoutEffects(std::vector<EffectCandidate> candidates,
                                            const std::vector<std::string>& effects);

/// The effects among candidates, each once.
std::set<std::string> EffectsOf(const std::vector<EffectCandidate>& candidates);

/// The candidate with what its grid holds, or starts from, coarsely (a cable's length and damping,
/// the time of a change) moved to where `score` is best between the grid's neighbours, one after
/// the other.
EffectCandidate WithRefinedSettings(const EffectCandidate& candidate,
                                    const std::function<double(const EffectCandidate&)>& score);

/// What follows from an effect's parameters and says more than these: the mass of the whole, all
/// loads counted [kg], and Effect::DerivedFigures().
std::vector<ParameterEstimate> DerivedFigures(const Vehicle& vehicle, const std::string& effect,
                                              const ParameterSet& online);

/// True if a parameter of an effect tells how large it is (Effect::size_parameters(); all of them
/// do where it names none): without a load's mass, its cable's place says nothing.
/// @param full_name "suspended_load.mass"
bool IsSizeParameter(const Vehicle& vehicle, const std::string& full_name);

/// True if an effect's first parameter is better explained by Effect::ordinary_sigma() than by its
/// own prior, its error counted with both.
/// @param vehicle any of the effect's; @param effect with the parameters that were found
bool IsOrdinary(const Vehicle& vehicle, const RankedEffect& effect);
/// What to warn of then: "rotor_delay.delay: 0.003 +- 0.0005 s, no more than ...".
std::string OrdinaryText(const Vehicle& vehicle, const RankedEffect& effect);

/// What manoeuvre tells two effects apart (Effect::distinguishing_manoeuvres() of either); empty
/// where none is known.
std::string TellingManoeuvre(const Vehicle& vehicle, const std::string& effect,
                             const std::string& alternative);

}  // namespace odmc
