#pragma once

#include <string>

#include "odmc/model/vehicle.h"

namespace odmc {

/// Reads a vehicle file (docs/vehicle_file.md).
/// @throws std::invalid_argument with a sentence that names file and key: unknown keys, wrong
/// types,
///   missing keys, non-positive masses, NaN, duplicate rotors, unknown effects or parameters.
Vehicle LoadVehicle(const std::string& file);

/// The same from YAML text; `file` only names the source in errors.
Vehicle ParseVehicle(const std::string& text, const std::string& file);

/// Gives a vehicle its calibrated actuators. Their k_m and k_f, with sigma, become start value and
/// prior of the estimate, where the vehicle file states none.
/// @throws std::invalid_argument if the numbers of motors and rotors differ
void IncludeActuator(const Actuator& actuator, Vehicle* vehicle);

}  // namespace odmc
