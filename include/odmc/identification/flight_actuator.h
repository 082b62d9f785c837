#pragma once

#include <vector>

#include "odmc/actuator/rotor_source.h"
#include "odmc/identification/identification.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// A flight as a bench run: every command and rotor sample is a row.
/// @throws std::invalid_argument if the flight has no commands
BenchRun BenchRunOf(const FlightLog& log);

/// Rotors whose sensor does not fit its commands as those of the others do: speed over the root of
/// throttle and voltage is more than 12 % off the median rotor's, or most readings are 0.
/// @returns indices from 0
std::vector<int> SuspectRotors(const FlightLog& log);

/// The actuators of a vehicle whose sensors are all but `bad` sound, from a flight of its own. Bad
/// rotors get what the others have in common.
/// @throws std::invalid_argument if fewer than two sensors are sound
Actuator ActuatorFromFlight(const FlightLog& log, const std::vector<int>& bad);

/// Runs a recorded flight's rotor speeds through a RotorSource.
/// @param actuator of the vehicle; empty: it is identified from the flight itself if a sensor looks
///   bad beside the others and the flight has commands
/// @param from_commands true: speeds come from the model alone
/// @returns what failed; a sentence for each goes to the log's warnings
/// @throws std::invalid_argument if `from_commands` and commands or actuator are missing
std::vector<RotorFault> SettleRotors(const std::optional<Actuator>& actuator, int num_rotors,
                                     bool from_commands, FlightLog* log);

}  // namespace odmc
