#include "odmc/phases/flight_phase.h"

#include <algorithm>

#include "odmc/text/format.h"

namespace odmc {
namespace {

/// True if it may follow flight because the vehicle has landed.
bool IsLanding(FlightPhase phase) {
  return !Teaches(phase) && phase != FlightPhase::kInHand && phase != FlightPhase::kInContact;
}

}  // namespace

const char* Name(FlightPhase phase) {
  switch (phase) {
    case FlightPhase::kOff:
      return "off";
    case FlightPhase::kIdling:
      return "idling";
    case FlightPhase::kOnGround:
      return "on_ground";
    case FlightPhase::kLiftingOff:
      return "lifting_off";
    case FlightPhase::kFlying:
      return "flying";
    case FlightPhase::kFalling:
      return "falling";
    case FlightPhase::kTouchingDown:
      return "touching_down";
    case FlightPhase::kInHand:
      return "in_hand";
    case FlightPhase::kInContact:
      return "in_contact";
    case FlightPhase::kUpsideDown:
      return "upside_down";
    case FlightPhase::kCrashed:
      return "crashed";
  }
  return "";
}

std::string PhaseSpan::Describe(Stamp zero) const {
  return Format("%s from %.2f to %.2f s: thrust %.2f of the weight, %.2f of it missing",
                Name(phase), ToSeconds(from - zero), ToSeconds(to - zero), thrust_ratio,
                missing_force);
}

bool IsInside(Stamp stamp, const StampSpans& spans) {
  return std::any_of(spans.begin(), spans.end(), [stamp](const auto& span) {
    return stamp >= span.first && stamp <= span.second;
  });
}

StampSpans NotInFlight(const std::vector<PhaseSpan>& phases, double before_landing_s) {
  StampSpans spans;
  const PhaseSpan* flight = nullptr;
  bool follows = false;
  for (const PhaseSpan& phase : phases) {
    if (Teaches(phase.phase)) {
      flight = &phase;
      follows = false;
    } else if (follows) {
      spans.back().second = phase.to;
    } else {
      Stamp from = phase.from;
      if (flight != nullptr && IsLanding(phase.phase)) {
        from = std::max(flight->from, from - FromSeconds(before_landing_s));
      }
      spans.emplace_back(from, phase.to);
      follows = true;
    }
  }
  return spans;
}

}  // namespace odmc
