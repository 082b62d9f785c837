#pragma once

#include "bag_source.h"
#include "odmc/io/flight_reader.h"

namespace odmc {

/// Whether a bag is one of the Blackbird data set. Its poses are NED, which no type says: its own
/// topic name does.
bool IsBlackbird(const BagSource& bag, const BagOptions& options);

FlightLog ReadBlackbirdBag(BagSource* bag, const FlightReadOptions& read);

}  // namespace odmc
