#pragma once

#include <string>
#include <vector>

namespace odmc::tools {

/// The flights that names of files, folders and patterns stand for, as FlightArguments::Expand().
std::vector<std::string> FlightsNamed(const std::vector<std::string>& names);

}  // namespace odmc::tools
