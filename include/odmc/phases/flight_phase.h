#pragma once

#include <string>
#include <utility>
#include <vector>

#include "odmc/sensing/samples.h"

namespace odmc {

/// What a vehicle is doing. Only kFlying and kFalling are free of forces other than gravity and
/// air, so only they teach anything about the model.
enum class FlightPhase {
  kOff,           ///< stands, rotors stand
  kIdling,        ///< stands, rotors turn slowly
  kOnGround,      ///< stands under thrust
  kLiftingOff,    ///< the ground still carries a share, the vehicle begins to move
  kFlying,        ///< in the air, carried by its rotors
  kFalling,       ///< in the air, thrown or falling: hardly any specific force
  kTouchingDown,  ///< the first moments on the ground
  kInHand,        ///< carried: moves, and not by its rotors
  kInContact,     ///< a force acts that is neither of the model nor the ground's
  kUpsideDown,    ///< lies on its back
  kCrashed,       ///< lies after a hard impact
};
constexpr int kNumFlightPhases = static_cast<int>(FlightPhase::kCrashed) + 1;

/// "off", "idling", "on_ground", "lifting_off", "flying", "falling", "touching_down", "in_hand",
/// "in_contact", "upside_down" or "crashed".
const char* Name(FlightPhase phase);

/// True if the estimate may learn from it.
inline bool Teaches(FlightPhase phase) {
  return phase == FlightPhase::kFlying || phase == FlightPhase::kFalling;
}

/// One stretch of a flight in one phase.
struct PhaseSpan {
  FlightPhase phase = FlightPhase::kFlying;
  Stamp from = 0, to = 0;      ///< first and last keyframe
  double missing_force = 0.0;  ///< mean of the force that the model does not give, over the weight
  double thrust_ratio = 0.0;   ///< mean thrust over the weight

  /// "on_ground from 3.1 to 5.2 s: thrust 0.51 of the weight, 0.48 of it carried by something
  /// else".
  /// @param zero stamp from which seconds count
  std::string Describe(Stamp zero) const;
};

/// First and last stamp of each of several spans.
using StampSpans = std::vector<std::pair<Stamp, Stamp>>;

/// True within a span, its ends counted.
bool IsInside(Stamp stamp, const StampSpans& spans);

/// A foot touches, and may bounce, so long before the ground's force lasts and shows a landing.
constexpr double kFirstTouch_s = 0.3;

/// The spans that are not to be looked at, neighbours joined: all phases that teach nothing.
/// @param before_landing_s so much of the flight before a stretch on the ground belongs to it
StampSpans NotInFlight(const std::vector<PhaseSpan>& phases,
                       double before_landing_s = kFirstTouch_s);

}  // namespace odmc
