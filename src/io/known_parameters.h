#pragma once

#include <map>
#include <string>
#include <vector>

#include "odmc/model/parameter.h"
#include "odmc/model/vehicle.h"

namespace odmc {

/// Specs of every parameter that any registered effect has for this vehicle, by full name. Names,
/// units and default states are the same for every vehicle.
std::map<std::string, ParameterSpec> KnownParameters(const Vehicle& vehicle);

/// Its names.
std::vector<std::string> NamesOf(const std::map<std::string, ParameterSpec>& specs);

}  // namespace odmc
