#include "odmc/analysis/phase_findings.h"

#include "odmc/text/format.h"

namespace odmc {
namespace {

/// A stretch in the middle of a flight that was set aside.
Finding SetAside(const PhaseSpan& span, Stamp zero) {
  Finding finding;
  const bool is_crash = span.phase == FlightPhase::kCrashed;
  finding.check = is_crash ? "crash" : "contact";
  finding.span_s = {ToSeconds(span.from - zero), ToSeconds(span.to - zero)};
  finding.what =
      std::string(is_crash ? "the vehicle crashed" : "a force acts that is not the model's") +
      Format(" from %.2f to %.2f s (%.2f of the weight)", finding.span_s->first,
             finding.span_s->second, span.missing_force) +
      ": nothing was learned there";
  return finding;
}

Finding NeverMoved() {
  Finding finding;
  finding.check = "never_moved";
  finding.leaves = Trust::kDoubtful;
  finding.what =
      "the vehicle was never seen to move by its own thrust: it hovers on the spot, or "
      "stands on the ground";
  finding.mend = "fly some metres, so that the thrust coefficient shows";
  return finding;
}

}  // namespace

Finding VehicleChanged(Stamp stamp, Stamp zero) {
  Finding finding;
  finding.check = "vehicle_changed";
  finding.leaves = Trust::kDoubtful;
  finding.span_s = {ToSeconds(stamp - zero), ToSeconds(stamp - zero)};
  finding.what = Format(
      "at %.2f s the vehicle became another one: thrust carries it by a steady share "
      "more or less than before",
      finding.span_s->first);
  finding.mend =
      "a load, a propeller, a battery, or a rotor-speed sensor; split the recording there, "
      "or use detect_changes";
  return finding;
}

std::vector<Finding> PhaseFindings(const ReplayResult& replay, bool learns_changes, Stamp zero) {
  std::vector<Finding> findings;
  for (const PhaseSpan& span : replay.phases) {
    const bool is_contact =
        span.phase == FlightPhase::kInContact || span.phase == FlightPhase::kCrashed;
    if (is_contact) findings.push_back(SetAside(span, zero));
  }
  if (replay.counters.changes > 0 && !learns_changes) {
    findings.push_back(VehicleChanged(replay.counters.last_change, zero));
  }
  if (!replay.has_flown) findings.push_back(NeverMoved());
  return findings;
}

}  // namespace odmc
