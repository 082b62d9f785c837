#pragma once

#include <string>

#include "odmc/model/parameter_set.h"

namespace odmc {

/// Reads a parameters.yaml as SaveParameters() writes it; hand-made ones need only `effects` and
/// `parameters: {NAME: {value: X}}`; sigma is then 0, unit and state are the effect's own.
/// @throws std::invalid_argument with a sentence that names file and key.
ParameterSet LoadParameters(const std::string& file);
ParameterSet ParseParameters(const std::string& text, const std::string& file);

/// Writes effect list, values, sigmas, units, states, covariance and provenance. Numbers have as
/// many digits as it takes to read the same bits back (at most 17) and always carry a decimal
/// point, so that YAML 1.1 readers see floats.
/// @throws std::runtime_error if the file cannot be written, std::invalid_argument naming the key
/// if
///   a number is not finite.
void SaveParameters(const ParameterSet& set, const std::string& file);
std::string FormatParameters(const ParameterSet& set);

}  // namespace odmc
