#pragma once

#include <vector>

#include "odmc/sensing/samples.h"
#include "odmc/text/finding.h"

namespace odmc {

/// Finds streams whose samples bear the time of their arrival (bursts of a serial line, a busy
/// computer) and not that of the measurement, and gives them even stamps: each the value of a line
/// through the stamps around it against their count. A constant delay stays, see InspectStreams().
/// Streams that lost samples, or have another rate than they should, are left alone: their stamps
/// keep their distance. Checks "rotor_jitter", "pose_jitter", "imu_jitter".
std::vector<Finding> EvenOutStamps(FlightLog* log);

}  // namespace odmc
