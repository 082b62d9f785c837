#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "odmc/analysis/torque_bands.h"

namespace odmc {

/// Entry "inertia_by_band" of a report.
/// @param nominal the vehicle file's inertia [kg m²]
nlohmann::ordered_json TorqueBandsJson(const TorqueBands& bands, const Eigen::Vector3d& nominal);

/// The same for the terminal.
std::string TorqueBandsTable(const TorqueBands& bands, const Eigen::Vector3d& nominal);

}  // namespace odmc
