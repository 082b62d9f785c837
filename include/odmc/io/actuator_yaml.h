#pragma once

#include <string>

#include "odmc/model/motor.h"

namespace odmc {

/// Reads an actuator file as SaveActuator() writes it.
/// @throws std::invalid_argument with a sentence that names file and key
Actuator LoadActuator(const std::string& file);
Actuator ParseActuator(const std::string& text, const std::string& file);

/// @param provenance one line for the head of the file: where the values come from
/// @throws std::runtime_error if the file cannot be written
void SaveActuator(const Actuator& actuator, const std::string& provenance, const std::string& file);
std::string FormatActuator(const Actuator& actuator, const std::string& provenance);

}  // namespace odmc
