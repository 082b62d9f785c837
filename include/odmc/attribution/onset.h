#pragma once

#include <optional>

#include "odmc/attribution/ranked_effect.h"
#include "odmc/attribution/residual.h"
#include "odmc/model/dynamic_model.h"

namespace odmc {

/// When an effect with an onset (Effect::onset_parameter()) began, by least squares over the whole
/// flight, blocks held out included: a fit that does not see these cannot tell a moment within one
/// from another. Everything else of the fit stays. Each channel weighs by the inverse of the
/// variance that the fit leaves in it.
/// @param values of `model`, with the effect and its onset as the fit has them
/// @returns the time [s], halfway between two samples; nothing where the effect has no onset, or
/// acts from the recording's start
std::optional<double> OnsetByWholeFlight(const RankedEffect& effect, const ResidualModel& residual,
                                         const DynamicModel& model, const ModelValues& values);

}  // namespace odmc
