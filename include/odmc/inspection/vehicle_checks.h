#pragma once

#include <vector>

#include "odmc/inspection/motion_signals.h"
#include "odmc/inspection/stream_inspection.h"

namespace odmc {

/// Is a quantity of the file in another unit, see FindUnitError()? Needs no flight. Check
/// "vehicle_units".
void CheckVehicleUnits(const Vehicle& vehicle, StreamInspection* inspection);

/// Can the inertia belong to a body of this mass and size? Needs no flight.
void CheckInertiaBounds(const Vehicle& vehicle, StreamInspection* inspection);

/// Is the file's gravity that of the Earth? Needs no flight.
void CheckGravity(const Vehicle& vehicle, StreamInspection* inspection);

/// Does thrust carry the weight with the file's k_f and mass, and does it point up: along the
/// body's z and against the world's? Are the rotor speeds in rad/s, see FindRotorUnit()?
void CheckThrust(const MotionSignals& signals, const Vehicle& vehicle,
                 const std::vector<bool>& flight, StreamInspection* inspection);

/// Does the file's inertia turn as the rotors' torque says? @param torque from RotorOffset()
void CheckInertia(const MotionSignals& signals, const Vehicle& vehicle,
                  const std::vector<bool>& flight, const TimeOffset& torque,
                  StreamInspection* inspection);

}  // namespace odmc
