#pragma once

#include "odmc/sensing/samples.h"

namespace odmc {

/// Standard deviation of the noise of each rotor's measured speed [rad/s], from fourth differences
/// of neighbouring samples: rotors do not move that quickly. Median, so that wild samples and steps
/// do not count.
RotorVector RotorNoise(const std::vector<RotorSample>& rotors);

/// The flight with as much noise added to the rotor speeds as they have already.
/// @param draw which of many equal ones; the same each time
FlightLog WithMoreRotorNoise(const FlightLog& log, unsigned draw);

}  // namespace odmc
