#pragma once

#include <string>

#include "odmc/sensing/samples.h"

namespace odmc {

/// What a process that reads a flight for another one says.
struct FlightAnswer {
  FlightLog log;
  std::string error;  ///< a sentence; empty where `log` is the flight
};

/// Writes an answer, every bit of it, to an open file descriptor.
/// @throws std::runtime_error where the other end is gone
void SendFlight(FlightAnswer answer, int descriptor);

/// Reads what SendFlight() wrote.
/// @throws std::runtime_error where it is not whole
FlightAnswer ReceiveFlight(int descriptor);

}  // namespace odmc
