#pragma once

#include <deque>
#include <optional>
#include <vector>

#include "odmc/ros/streams.h"

namespace odmc {

/// Puts the velocities of a stream of twists to the poses beside it: each pose gets the velocity at
/// its stamp, on the line between the twists before and after. Poses wait for the twist after them
/// (100 ms of stamps at most; then they go without a velocity) and come out as odometry. The first
/// poses wait for the first twist, 0.5 s at most: then poses stay what they are, and twists are not
/// used. Thread-compatible.
class PoseTwistPairing {
 public:
  /// @param is_expected  twists come, however late
  explicit PoseTwistPairing(bool is_expected = false)
      : mode_(is_expected ? Mode::kPaired : Mode::kWaiting) {}

  /// Each returns what is ready, in the order of stamps.
  std::vector<OdometryInput> AddPose(OdometryInput pose);
  /// @param twist  its velocity as `linear`, the header's frame as `frame_id`
  std::vector<OdometryInput> AddTwist(OdometryInput twist);
  /// What still waits, at the end of a recording.
  std::vector<OdometryInput> Flush();

  /// True if twists come and are not used.
  bool is_late() const { return is_late_; }
  /// That wait for poses.
  size_t num_twists() const { return twists_.size(); }

 private:
  enum class Mode { kWaiting, kPaired, kAlone };

  void Follow(Stamp stamp, std::optional<Stamp>* newest);
  /// Of both streams, at least one of which has begun.
  Stamp newest() const;
  std::vector<OdometryInput> Release(bool all);
  void SetVelocity(OdometryInput* pose) const;

  std::deque<OdometryInput> poses_, twists_;
  std::optional<Stamp> newest_pose_, newest_twist_;
  Mode mode_;
  bool is_late_ = false;
};

}  // namespace odmc
