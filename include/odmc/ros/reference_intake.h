#pragma once

#include <optional>
#include <vector>

#include "odmc/sensing/samples.h"
#include "odmc/trajectory/flat_reference.h"

namespace odmc {

/// One point of a trajectory message, in the order of time.
struct TimedReference {
  Stamp stamp = 0;
  FlatReference reference;
};

/// Between two points: the polynomials of degree 5 in x, y, z and yaw that have position, velocity
/// and acceleration of both, which give jerk and snap, too. Yaw is not unwrapped.
/// @pre from.stamp < to.stamp
FlatReference ReferenceBetween(const TimedReference& from, const TimedReference& to, Stamp at);

/// `reference` moved on by `dt` seconds of constant snap.
FlatReference ReferenceMovedOn(const FlatReference& reference, double dt);

/// What a controller shall follow now, from messages that came earlier: single references, moved
/// on to now by their derivatives, or trajectories. Single references go first while they come.
/// One that stays out is followed for kMovesOn_s; after timeout_s its last place is held.
/// Thread-compatible.
class ReferenceIntake {
 public:
  /// @param timeout_s silence after which a reference has gone, > 0 [s]
  explicit ReferenceIntake(double timeout_s) : timeout_s_(timeout_s) {}

  void Add(const TimedReference& point) { newest_ = point; }

  /// Takes the place of the trajectory that is there.
  /// @param points one or more, stamps strictly forward; one point is a reference by itself
  void Add(std::vector<TimedReference> points) { trajectory_ = std::move(points); }

  /// Nothing before the first message.
  std::optional<FlatReference> At(Stamp now) const;

  /// True if the source fell silent in flight: the last place is held.
  bool IsLost(Stamp now) const;

  void Reset();

  static constexpr double kMovesOn_s = 0.1;

 private:
  bool FollowsTrajectory(Stamp now) const;
  FlatReference After(const TimedReference& point, Stamp now) const;

  double timeout_s_;
  std::optional<TimedReference> newest_;
  std::vector<TimedReference> trajectory_;
};

}  // namespace odmc
