#pragma once

#include <nlohmann/json.hpp>
#include <vector>

#include "odmc/model/dynamic_model.h"
#include "odmc/model/parameter_set.h"

namespace odmc {

/// Parameters for a report.json, by name: value, sigma (0 where frozen), unit, state.
nlohmann::ordered_json ParametersJson(const std::vector<ParameterEstimate>& parameters);

/// The same with what the flight says of them: whether they are observable, and whether the sign is
/// one that physics does not allow.
/// @param model that has them; others' signs may be any
nlohmann::ordered_json ParametersJson(const std::vector<ParameterEstimate>& parameters,
                                      const DynamicModel& model);

}  // namespace odmc
