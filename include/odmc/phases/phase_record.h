#pragma once

#include <vector>

#include "odmc/phases/flight_phase.h"
#include "odmc/phases/phase_block.h"

namespace odmc {

/// The phases of a flight so far, as spans without gaps. A span begins where its phase did, which
/// may be known only later: spans after that are replaced.
class PhaseRecord {
 public:
  /// Oldest first; the oldest go when there are more than 1000.
  const std::vector<PhaseSpan>& spans() const { return spans_; }
  FlightPhase phase() const { return phase_; }

  /// The newest span lasts until `stamp`.
  void ExtendTo(Stamp stamp);
  /// From `since` on the phase is `phase`, unless it is already. @param now end of the newest block
  void SetPhase(FlightPhase phase, Stamp since, Stamp now);
  /// The same, whatever was recorded after `since`.
  void Relabel(FlightPhase phase, Stamp since, Stamp now);
  /// The newest span's means take in one block more.
  void Average(const PhaseBlock& block);
  /// Of the newest span, over the weight.
  void SetMeans(double thrust_ratio, double missing_force);
  /// What follows is another recording; the spans stay.
  void Restart();

 private:
  FlightPhase phase_ = FlightPhase::kFlying;
  std::vector<PhaseSpan> spans_;
  double averaged_s_ = 0.0;  // of the newest span
};

}  // namespace odmc
