#include "odmc/inspection/rotor_inspection.h"

#include "odmc/inspection/rotor_assignment.h"
#include "odmc/inspection/rotor_blocks.h"
#include "odmc/inspection/rotor_regression.h"
#include "odmc/inspection/rotor_scale.h"

namespace odmc {

RotorInspection InspectRotors(const FlightLog& log, const Vehicle& vehicle) {
  const RotorResponse response = MeasureRotorResponse(CutRotorBlocks(log, vehicle), vehicle);
  const RotorScale scale = FindRotorScale(response, vehicle);
  if (scale.reads_zero) {  // its motion is missing, too
    return {ScaleFindings(scale, vehicle), {}};
  }
  const std::vector<Finding> findings =
      AssignmentFindings(TestRotorAssignment(response, vehicle), vehicle);
  // Scales are judged by the file's places and spins: only where these are right.
  if (!findings.empty()) return {findings, {}};
  return {ScaleFindings(scale, vehicle), scale.doubts};
}

}  // namespace odmc
