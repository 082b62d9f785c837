#pragma once

#include <vector>

#include "odmc/inspection/stream_doubt.h"
#include "odmc/model/vehicle.h"
#include "odmc/sensing/samples.h"
#include "odmc/text/finding.h"

namespace odmc {

/// What the motion says about the rotor speeds.
struct RotorInspection {
  std::vector<Finding> findings;
  std::vector<StreamDoubt> doubts;  ///< of single rotors' readings
};

/// Tests rotor speeds against the motion, before anything is estimated: their order and spins
/// (checks "rotor_order", "rotor_spin") and single readings that are scaled or dead
/// ("rotor_scale"). Works on a whole flight as well as on a buffer of the last minutes.
RotorInspection InspectRotors(const FlightLog& log, const Vehicle& vehicle);

}  // namespace odmc
