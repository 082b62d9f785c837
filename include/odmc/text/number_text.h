#pragma once

#include <string>
#include <string_view>

namespace odmc {

/// Reads the whole of `text` as a number in C notation, blanks around it allowed; also nan and inf.
/// Independent of the locale.
/// @returns false where anything else is in `text`.
bool ParseNumber(std::string_view text, double* value);

/// Shortest text that reads back as the same double (at most 17 digits).
std::string FormatNumber(double value);

/// As FormatNumber(), with a decimal point in any case: `1.0e-06`, not `1e-06`. YAML 1.1 readers
/// (PyYAML, rosparam) take a number without a point before its exponent for text.
std::string FormatYamlNumber(double value);

}  // namespace odmc
