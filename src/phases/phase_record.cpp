#include "odmc/phases/phase_record.h"

#include <algorithm>

namespace odmc {
namespace {

constexpr size_t kMostSpans = 1000;

}  // namespace

void PhaseRecord::ExtendTo(Stamp stamp) {
  if (!spans_.empty()) spans_.back().to = stamp;
}

void PhaseRecord::SetPhase(FlightPhase phase, Stamp since, Stamp now) {
  if (!spans_.empty() && spans_.back().phase == phase) {
    phase_ = phase;
    return;
  }
  Relabel(phase, since, now);
}

void PhaseRecord::Relabel(FlightPhase phase, Stamp since, Stamp now) {
  phase_ = phase;
  while (!spans_.empty() && spans_.back().from >= since) spans_.pop_back();
  if (!spans_.empty() && spans_.back().phase == phase) {
    spans_.back().to = now;
    return;
  }
  if (!spans_.empty()) spans_.back().to = std::min(spans_.back().to, since);
  if (spans_.size() >= kMostSpans) spans_.erase(spans_.begin());
  spans_.push_back({phase, since, std::max(since, now), 0.0, 0.0});
  averaged_s_ = 0.0;
}

void PhaseRecord::Average(const PhaseBlock& block) {
  if (spans_.empty()) return;
  PhaseSpan& span = spans_.back();
  averaged_s_ += block.duration_s;
  const double gain = block.duration_s / averaged_s_;
  span.missing_force += gain * (block.missing.norm() - span.missing_force);
  span.thrust_ratio += gain * (block.thrust - span.thrust_ratio);
}

void PhaseRecord::SetMeans(double thrust_ratio, double missing_force) {
  spans_.back().thrust_ratio = thrust_ratio;
  spans_.back().missing_force = missing_force;
}

void PhaseRecord::Restart() {
  phase_ = FlightPhase::kFlying;
  averaged_s_ = 0.0;
}

}  // namespace odmc
