#include "odmc/ros/tf_odometry.h"

#include <tf2/exceptions.h>
#include <tf2_msgs/TFMessage.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "odmc/ros/message_values.h"
#include "odmc/sensing/topic_clock.h"

namespace odmc {
namespace {

constexpr double kPatience_s = 0.5;  // of stamps, for the links above
constexpr double kCache_s = 10.0;    // more than any patience
constexpr size_t kMostFrames = 100;  // a chain that is longer is a ring

/// tf2 would refuse these by an error in the log.
bool IsSound(const geometry_msgs::TransformStamped& m) {
  const Eigen::Quaterniond q = ToEigen(m.transform.rotation);
  return ToEigen(m.transform.translation).allFinite() && q.coeffs().allFinite() &&
         std::abs(q.norm() - 1.0) < 1e-3 && !WithoutSlash(m.header.frame_id).empty() &&
         !WithoutSlash(m.child_frame_id).empty() &&
         WithoutSlash(m.header.frame_id) != WithoutSlash(m.child_frame_id);
}

}  // namespace

std::string WithoutSlash(const std::string& frame) {
  return !frame.empty() && frame[0] == '/' ? frame.substr(1) : frame;
}

TfOdometry::TfOdometry(std::string parent, std::string child)
    : parent_(WithoutSlash(parent)),
      child_(WithoutSlash(child)),
      buffer_(ros::Duration(kCache_s)) {}

std::vector<OdometryInput> TfOdometry::Read(const RawMessage& message, InputStream stream) {
  const auto m = DecodeMessage<tf2_msgs::TFMessage>(message);
  return Add(m.transforms, stream == InputStream::kStaticTf);
}

std::vector<OdometryInput> TfOdometry::Add(
    const std::vector<geometry_msgs::TransformStamped>& transforms, bool is_static) {
  for (const geometry_msgs::TransformStamped& transform : transforms) {
    const Stamp stamp = FromRos(transform.header.stamp);
    const bool has_stamp = is_static || stamp > 0;
    if (!has_stamp || !IsSound(transform) || !Insert(transform, is_static) || is_static) continue;
    if (SampledLink() == WithoutSlash(transform.child_frame_id) && stamp > newest_sampled_) {
      waiting_.push_back(stamp);
      newest_sampled_ = stamp;
    }
  }
  std::vector<OdometryInput> ready;
  while (!waiting_.empty()) {
    const Stamp stamp = waiting_.front();
    if (!Release(stamp, &ready)) {
      if (ToSeconds(newest_sampled_ - stamp) <= kPatience_s) break;
      ++unmatched_;
    }
    waiting_.pop_front();
  }
  return ready;
}

/// @returns false for what came before
bool TfOdometry::Insert(const geometry_msgs::TransformStamped& transform, bool is_static) {
  const Stamp stamp = FromRos(transform.header.stamp);
  const std::string child = WithoutSlash(transform.child_frame_id);
  const auto known = links_.find(child);
  const bool is_known = known != links_.end() && !known->second.is_static;
  if (!is_static && is_known) {
    if (IsStepBack(known->second.newest, stamp)) {
      ForgetMoving();
    } else if (stamp <= known->second.newest) {
      ++repeated_;
      return false;
    }
  }
  if (!buffer_.setTransform(transform, "", is_static)) return false;
  if (is_static) static_transforms_[child] = transform;
  links_[child] = {WithoutSlash(transform.header.frame_id), is_static, stamp};
  return true;
}

/// The clock started again: what moved is of the old time.
void TfOdometry::ForgetMoving() {
  buffer_.clear();
  links_.clear();
  waiting_.clear();
  newest_sampled_ = 0;
  for (const auto& [child, transform] : std::exchange(static_transforms_, {})) {
    Insert(transform, true);
  }
}

/// `frame` and the frames it hangs on, up to the root.
std::vector<std::string> TfOdometry::UpFrom(const std::string& frame) const {
  std::vector<std::string> frames = {frame};
  for (auto link = links_.find(frame); link != links_.end() && frames.size() < kMostFrames;
       link = links_.find(frames.back())) {
    frames.push_back(link->second.parent);
  }
  return frames;
}

/// The moving link whose stamps count, by its child: the one next to child_, seen from there.
std::string TfOdometry::SampledLink() const {
  const std::vector<std::string> from_child = UpFrom(child_), from_parent = UpFrom(parent_);
  const auto first_moving = [this](const std::vector<std::string>& way,
                                   const std::vector<std::string>& other) -> std::string {
    for (const std::string& frame : way) {
      const bool is_common = std::find(other.begin(), other.end(), frame) != other.end();
      const auto link = links_.find(frame);
      if (is_common || link == links_.end()) return "";
      if (!link->second.is_static) return frame;
    }
    return "";
  };
  const std::string sampled = first_moving(from_child, from_parent);
  return sampled.empty() ? first_moving(from_parent, from_child) : sampled;
}

bool TfOdometry::Release(Stamp stamp, std::vector<OdometryInput>* ready) const {
  try {
    const geometry_msgs::TransformStamped m =
        buffer_.lookupTransform(parent_, child_, ToRos(stamp));
    OdometryInput input;
    input.sample.stamp = stamp;
    input.sample.p_WS = ToEigen(m.transform.translation);
    input.sample.q_WS = ToEigen(m.transform.rotation);
    input.frame_id = parent_;
    input.is_pose = true;
    ready->push_back(std::move(input));
    return true;
  } catch (const tf2::TransformException&) {
    return false;
  }
}

std::string TfOdometry::Describe() const {
  std::string text;
  for (const auto& [child, link] : links_) {
    text += (text.empty() ? "" : ", ") + link.parent + " -> " + child;
  }
  return "tf does not lead from " + parent_ + " to " + child_ + "; it has " +
         (text.empty() ? "nothing" : text);
}

}  // namespace odmc
