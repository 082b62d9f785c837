#include "odmc/inspection/recording_inspection.h"

#include "odmc/inspection/rotor_inspection.h"
#include "odmc/inspection/stamp_checks.h"

namespace odmc {

StreamInspection InspectRecording(const Vehicle& vehicle, FlightLog* log) {
  std::vector<Finding> findings = EvenOutStamps(log);
  StreamInspection inspection = InspectStreams(*log, vehicle);
  findings.insert(findings.end(), inspection.findings.begin(), inspection.findings.end());
  MendStreams(inspection, log);
  const RotorInspection rotors = InspectRotors(*log, vehicle);
  findings.insert(findings.end(), rotors.findings.begin(), rotors.findings.end());
  inspection.findings = findings;
  inspection.doubts.insert(inspection.doubts.end(), rotors.doubts.begin(), rotors.doubts.end());
  for (const Finding& finding : rotors.findings) {
    if (finding.leaves == Trust::kBad && inspection.refusal.empty()) {
      inspection.refusal = Sentence(finding);
    }
  }
  return inspection;
}

}  // namespace odmc
