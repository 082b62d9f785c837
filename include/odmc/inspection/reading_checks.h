#pragma once

#include <vector>

#include "odmc/model/vehicle.h"
#include "odmc/sensing/samples.h"
#include "odmc/text/finding.h"

namespace odmc {

/// What single streams show by themselves, before they are compared: poses and rotor speeds of
/// different clocks ("clocks"), missing stretches ("holes"), positions that leap ("pose_jump"),
/// poses that stay in flight ("frozen_pose"), rotor speeds that end at a limit ("rotor_limit"), a
/// battery's voltage in another unit ("battery_unit").
std::vector<Finding> CheckReadings(const FlightLog& log, const Vehicle& vehicle);

}  // namespace odmc
