#pragma once

#include <string>
#include <vector>

#include "odmc/attribution/flexible_features.h"
#include "odmc/attribution/model_point.h"

namespace odmc {

/// Effects whose wrench another effect of the same model makes, too, with other coefficients: a hub
/// moment is an anisotropic one whose two coefficients are equal. Beside that it says nothing.
/// @param flights on these the two are compared
/// @param point a model with all of them
/// @param effects which are asked about
/// @param other the effect that may contain them
/// @returns names of those that it contains, in the order of `effects`
std::vector<std::string> ContainedEffects(const std::vector<FlightWithInstruments>& flights,
                                          const ModelPoint& point,
                                          const std::vector<std::string>& effects,
                                          const std::string& other);

}  // namespace odmc
