#pragma once

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
                                      const std::vector<Candidate>& candidates);

/// The case for an effect by an online estimate of the model that has it: gain of log evidence is
/// the density of its parameters at zero a priori over the same a posteriori (Savage's ratio;
/// Dickey, Ann. Math. Stat. 42, 1971), both normal, and what the signs say.
/// @param candidates number of effects that were tried, by which the p-value is corrected
/// @returns minus infinity for a score where the estimate says nothing of it
RankedEffect RankedByEstimate(const std::string& effect, const ParameterSet& online,
                              const DynamicModel& model, size_t candidates);

}  // namespace odmc
