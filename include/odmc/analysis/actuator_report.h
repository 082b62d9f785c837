#pragma once

#include <string>
#include <vector>

#include "odmc/identification/actuator_calibration.h"

namespace odmc {

/// Free-run error on a run the fit has not seen.
struct ActuatorEvaluation {
  std::string file;
  std::vector<FreeRunError> motors;
};

/// report.json of calibrate_actuator; what can't be had is null.
std::string ActuatorReport(const ActuatorCalibration& calibration,
                           const std::vector<BenchRun>& runs,
                           const std::vector<ActuatorEvaluation>& evaluations);

/// The same for a terminal.
std::string ActuatorTable(const ActuatorCalibration& calibration,
                          const std::vector<ActuatorEvaluation>& evaluations);

/// file, motor, t_s, command, voltage_V, measured_rad_s, predicted_rad_s, phase: free runs of every
/// motor over every run.
/// @throws std::runtime_error if the file cannot be written
void WriteFreeRuns(const ActuatorCalibration& calibration, const std::vector<BenchRun>& runs,
                   const std::string& file);

}  // namespace odmc
