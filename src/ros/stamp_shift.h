#pragma once

#include "odmc/sensing/samples.h"

namespace odmc {

constexpr Stamp kSecond = 1000000000;
/// Holds by how much WriteFlightBag() moved the stamps.
constexpr char kShiftTopic[] = "/stamp_shift";

}  // namespace odmc
