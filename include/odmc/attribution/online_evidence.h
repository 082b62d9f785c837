#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "odmc/attribution/attribution_options.h"
#include "odmc/attribution/candidates.h"
#include "odmc/attribution/ranked_effect.h"
#include "odmc/model/dynamic_model.h"
#include "odmc/model/parameter_set.h"

namespace odmc {

/// Candidates of which the regression is no judge. What an effect of the rotors' accelerations does
/// is over before the past could foresee it, so the instruments leave little of it. The online
/// estimator predicts from one keyframe to the next and needs no instruments. Noise that comes back
/// through the controller bends its estimate too, towards a rotor that helps what it should oppose:
/// so only effects whose sign physics gives are asked for this way.
/// @returns their names, each once
std::vector<std::string> QuickEffects(const Vehicle& vehicle,
                                      const std::vector<EffectCandidate>& candidates);

/// Candidates of rotor accelerations whose sign physics does not give: errors of the time stamps of
/// rotor speeds. About yaw, rotor speeds late by dt do what rotors of inertia 2 k_m Omega dt do, so
/// what QuickEffects() names has to show beside them.
/// @returns their names, each once
std::vector<std::string> RotorTimingEffects(const Vehicle& vehicle,
                                            const std::vector<EffectCandidate>& candidates);

/// The case for an effect by an online estimate of the model that has it: gain of log evidence is
/// the density of its parameters at zero a priori over the same a posteriori (Savage's ratio;
/// Dickey, Ann. Math. Stat. 42, 1971), both normal, and what the signs say.
/// @param candidates number of effects that were tried, by which the p-value is corrected
/// @param log_prior_odds of the effect, for its probability
/// @returns minus infinity for a score where the estimate says nothing of it
RankedEffect RankedByEstimate(const std::string& effect, const ParameterSet& online,
                              const DynamicModel& model, size_t candidates, double log_prior_odds);

/// The case for an effect by what bands of frequency know of its parameters: RankedByEstimate()
/// with their values and sigmas. The estimator weighs all frequencies, also those at which rotors
/// answer disturbances and noise; bands leave these out, and take off a delay common to all axes.
/// @param known KnownByBands(), by full name
/// @returns nothing where bands do not know each of the parameters
std::optional<RankedEffect> RankedByBands(const std::string& effect,
                                          const std::map<std::string, ParameterSetting>& known,
                                          const ParameterSet& online, const DynamicModel& model,
                                          size_t candidates, double log_prior_odds);

/// Adds to what an effect's own coefficients leave open (RankedEffect::spread) how they change in a
/// model that can do the same by other means.
/// @param beside the effect in that model, with the same coefficients
void AddAlternativeSpread(const RankedEffect& beside, RankedEffect* effect);

/// Adds to what an effect's own coefficients leave open that some are known as shares of another
/// quantity, as a rotor's inertia of I_z, and go with it.
/// @param names full names of those coefficients, with their values
/// @param sigma of the other quantity, over its value [1]
void AddScaleSpread(const std::map<std::string, ParameterSetting>& names, double sigma,
                    RankedEffect* effect);

/// The online model holds an effect's settings, such as a cable's length, as if they were known,
/// and knows one valley. Adds what the fit leaves open (RankedEffect::spread) to an online
/// estimate.
void AddSpread(const RankedEffect& effect, ParameterSet* online);

/// True if the online estimate of an effect's size differs from zero by more than `sigmas` (Wald's
/// test), or says nothing of it.
bool SizeDiffersFromZero(const RankedEffect& effect, const ParameterSet& online,
                         const DynamicModel& model, double sigmas);

/// True if the size of an effect would be zero within `significant_sigmas` for something between
/// minus and plus `change`.
/// @param change num_parameters()×1, what an error of a stream may make of the estimate
bool SizeMayBeZero(const RankedEffect& effect, const ParameterSet& online,
                   const Eigen::VectorXd& change, const DynamicModel& model,
                   const AttributionOptions& options);

/// True if the online estimate of an effect lies further from the fit than both sigmas explain.
bool ContradictsFit(const RankedEffect& effect, const ParameterSet& online);

/// What the online run says of an effect, " name = value +- sigma, ...".
std::string EstimatesText(const RankedEffect& effect, const ParameterSet& online,
                          const DynamicModel& model);

/// How much an online estimate speaks against what the regression found [nats]; infinite where the
/// two do not have the same parameters.
double NatsAgainst(const RankedEffect& effect, const ParameterSet& online,
                   const DynamicModel& model);

/// Two ways through the same data, the fit that chose an effect and the online estimator, find the
/// same coefficients where the effect is what acts. Where something else acts, what
/// each finds depends on its weights (Hausman, Specification tests in econometrics, 1978).
/// @returns what differs by more than three sigma and a third of itself; empty if they agree
std::string Disagreement(const RankedEffect& effect, const ParameterSet& online,
                         const DynamicModel& model, const AttributionOptions& options);

}  // namespace odmc
