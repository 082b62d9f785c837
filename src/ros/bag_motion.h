#pragma once

#include "bag_source.h"
#include "odmc/io/flight_reader.h"

namespace odmc {

/// Reads odometry, or poses where there is none or mocap is wanted; or tf.
void ReadMotion(BagSource* bag, const FlightReadOptions& read, const BagOptions& options,
                FlightLog* log);

}  // namespace odmc
