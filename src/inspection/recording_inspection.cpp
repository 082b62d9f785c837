#include "odmc/inspection/recording_inspection.h"

#include <algorithm>

#include "odmc/inspection/reading_checks.h"
#include "odmc/inspection/rotor_inspection.h"
#include "odmc/inspection/stamp_checks.h"
#include "odmc/text/refusal.h"

namespace odmc {

StreamInspection InspectRecording(const Vehicle& vehicle, FlightLog* log) {
  std::vector<Finding> findings = CheckReadings(*log, vehicle);
  const auto bad = std::find_if(findings.begin(), findings.end(),
                                [](const Finding& f) { return f.leaves == Trust::kBad; });
  if (bad != findings.end()) {
    StreamInspection refused;
    refused.refusal = Sentence(*bad);
    refused.findings = findings;
    return refused;
  }
  const std::vector<Finding> stamps = EvenOutStamps(log);
  findings.insert(findings.end(), stamps.begin(), stamps.end());
  StreamInspection inspection = InspectStreams(*log, vehicle);
  findings.insert(findings.end(), inspection.findings.begin(), inspection.findings.end());
  MendStreams(inspection, log);
  if (!inspection.refusal.empty()) {  // what comes after it would only be its consequences
    inspection.findings = findings;
    return inspection;
  }
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

StreamInspection InspectOrRefuse(const Vehicle& vehicle, bool force, const std::string& option,
                                 FlightLog* log) {
  StreamInspection inspection = InspectRecording(vehicle, log);
  if (!inspection.refusal.empty() && !force) {
    RefuseFile(log->file, inspection.refusal + " (" + option + " goes on all the same)");
  }
  return inspection;
}

}  // namespace odmc
