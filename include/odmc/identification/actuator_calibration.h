#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "odmc/actuator/thrust_stand.h"
#include "odmc/identification/identification.h"

namespace odmc {

/// Everything a bench says about a vehicle's actuators.
struct ActuatorCalibration {
  ActuatorFit fit;
  std::optional<StandFit> thrust, torque;
  std::optional<MeasuredValue> rotor_inertia_kg_m2;  ///< as it was given
  std::vector<ActuatorParameter> parameters;  ///< k_f, k_m and those of all motors as one type
  FreeRunError error;                         ///< of every motor's own fit, together
  std::vector<std::string> warnings;          ///< one sentence each
};

/// Whether any motor of the run ever read a speed above 0.
bool HasSpeeds(const BenchRun& run);

/// Fits motors and stand. Runs without any speed are left out, with a warning, unless all are.
/// @param rotor_inertia_kg_m2 of one rotor about its axis: makes k_m of S_2 where no stand measured
///   torque
/// @throws std::invalid_argument as IdentifyActuator()
ActuatorCalibration CalibrateActuator(const std::vector<BenchRun>& runs,
                                      const std::optional<MeasuredValue>& rotor_inertia_kg_m2);

/// What a vehicle file includes.
Actuator ActuatorOf(const ActuatorCalibration& calibration);

/// Error of free runs on a run that was not used for the fit, motor by motor.
/// @throws std::invalid_argument if the number of motors differs
std::vector<FreeRunError> EvaluateActuator(const Actuator& actuator, const BenchRun& run);

}  // namespace odmc
