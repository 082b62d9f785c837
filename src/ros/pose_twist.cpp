#include "odmc/ros/pose_twist.h"

#include <algorithm>
#include <iterator>
#include <utility>

#include "odmc/sensing/topic_clock.h"

namespace odmc {
namespace {

constexpr double kPatience_s = 0.1;  // a pose waits for the twist after it
constexpr double kSettle_s = 0.5;    // for the first twist to come
constexpr double kMostGap_s = 0.1;   // between the twists around a pose
constexpr double kKept_s = 1.0;      // of twists: longer than a pose waits, or is late

}  // namespace

std::vector<OdometryInput> PoseTwistPairing::AddPose(OdometryInput pose) {
  Follow(pose.sample.stamp, &newest_pose_);
  poses_.push_back(std::move(pose));
  const Stamp first = poses_.front().sample.stamp;
  if (mode_ == Mode::kWaiting && ToSeconds(newest() - first) > kSettle_s) mode_ = Mode::kAlone;
  return Release(false);
}

std::vector<OdometryInput> PoseTwistPairing::AddTwist(OdometryInput twist) {
  is_late_ = is_late_ || mode_ == Mode::kAlone;
  if (is_late_ || !twist.linear) return {};
  Follow(twist.sample.stamp, &newest_twist_);
  mode_ = Mode::kPaired;
  twists_.push_back(std::move(twist));
  // Where no poses come, nothing else lets go of them.
  while (ToSeconds(newest() - twists_.front().sample.stamp) > kKept_s) twists_.pop_front();
  return Release(false);
}

std::vector<OdometryInput> PoseTwistPairing::Flush() { return Release(true); }

/// Where a stream steps back behind itself, what waits is of the old time. (Behind the other one it
/// may be all the time: two clocks.)
void PoseTwistPairing::Follow(Stamp stamp, std::optional<Stamp>* newest) {
  if (*newest && IsStepBack(**newest, stamp)) {
    poses_.clear();
    twists_.clear();
    newest_pose_.reset();
    newest_twist_.reset();
  }
  *newest = std::max(stamp, newest->value_or(stamp));
}

Stamp PoseTwistPairing::newest() const {
  if (!newest_pose_) return *newest_twist_;
  return newest_twist_ ? std::max(*newest_pose_, *newest_twist_) : *newest_pose_;
}

std::vector<OdometryInput> PoseTwistPairing::Release(bool all) {
  std::vector<OdometryInput> ready;
  if (mode_ == Mode::kWaiting && !all) return ready;
  if (mode_ != Mode::kPaired) {
    std::move(poses_.begin(), poses_.end(), std::back_inserter(ready));
    poses_.clear();
    return ready;
  }
  while (!poses_.empty()) {
    OdometryInput& pose = poses_.front();
    const Stamp stamp = pose.sample.stamp;
    while (twists_.size() > 1 && twists_[1].sample.stamp <= stamp) twists_.pop_front();
    const bool has_next = !twists_.empty() && twists_.back().sample.stamp >= stamp;
    if (!has_next && !all && ToSeconds(newest() - stamp) <= kPatience_s) break;
    SetVelocity(&pose);
    pose.is_pose = false;
    ready.push_back(std::move(pose));
    poses_.pop_front();
  }
  return ready;
}

/// From the first two twists, which are those around the pose, if any are.
void PoseTwistPairing::SetVelocity(OdometryInput* pose) const {
  const Stamp stamp = pose->sample.stamp;
  if (twists_.empty() || twists_.front().sample.stamp > stamp) return;
  const OdometryInput& before = twists_.front();
  if (before.sample.stamp == stamp) {
    pose->linear = before.linear;
  } else if (twists_.size() > 1) {
    const OdometryInput& after = twists_[1];
    const Stamp gap = after.sample.stamp - before.sample.stamp;
    if (ToSeconds(gap) > kMostGap_s) return;
    const double share =
        static_cast<double>(stamp - before.sample.stamp) / static_cast<double>(gap);
    pose->linear = *before.linear + share * (*after.linear - *before.linear);
  }
  // As an odometry declares a velocity in the world; a frame of its own says nothing of the pose.
  if (before.frame_id == pose->frame_id) pose->child_frame_id = pose->frame_id;
}

}  // namespace odmc
