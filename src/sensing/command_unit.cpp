#include "odmc/sensing/command_unit.h"

namespace odmc {
namespace {

constexpr double kNoThrottle_us = 1000.0, kRange_us = 1000.0, kRange_raw16 = 65535.0;

}  // namespace

const char* NameOf(CommandUnit unit) {
  switch (unit) {
    case CommandUnit::kMicroseconds:
      return "us";
    case CommandUnit::kRaw16:
      return "raw16";
    case CommandUnit::kFraction:
      break;
  }
  return "fraction";
}

std::optional<CommandUnit> CommandUnitNamed(const std::string& name) {
  for (const CommandUnit unit :
       {CommandUnit::kMicroseconds, CommandUnit::kRaw16, CommandUnit::kFraction}) {
    if (name == NameOf(unit)) return unit;
  }
  return std::nullopt;
}

double ThrottlePer(CommandUnit unit) {
  if (unit == CommandUnit::kMicroseconds) return 1.0 / kRange_us;
  return unit == CommandUnit::kRaw16 ? 1.0 / kRange_raw16 : 1.0;
}

double ThrottleOf(double command, CommandUnit unit) {
  const double zero = unit == CommandUnit::kMicroseconds ? kNoThrottle_us : 0.0;
  return (command - zero) * ThrottlePer(unit);
}

double CommandOf(double throttle, CommandUnit unit) {
  const double zero = unit == CommandUnit::kMicroseconds ? kNoThrottle_us : 0.0;
  return zero + throttle / ThrottlePer(unit);
}

}  // namespace odmc
