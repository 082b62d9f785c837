#pragma once

#include <optional>
#include <string>

namespace odmc {

/// What a command of an ESC counts.
enum class CommandUnit {
  kMicroseconds,  ///< pulse width; 1000 is no throttle, 2000 full
  kRaw16,         ///< 0 to 65535
  kFraction,      ///< 0 to 1
};
const char* NameOf(CommandUnit unit);  ///< "us", "raw16", "fraction"
std::optional<CommandUnit> CommandUnitNamed(const std::string& name);

/// Throttle, 0 to 1 in regular use, of a command; and back.
double ThrottleOf(double command, CommandUnit unit);
double CommandOf(double throttle, CommandUnit unit);
/// Size of one unit of command in throttle.
double ThrottlePer(CommandUnit unit);

}  // namespace odmc
