#pragma once

#include <geometry_msgs/TransformStamped.h>
#include <tf2/buffer_core.h>

#include <deque>
#include <map>
#include <string>
#include <vector>

#include "odmc/ros/raw_message.h"
#include "odmc/ros/streams.h"

namespace odmc {

/// Poses of a frame in another from messages of tf, wherever the two hang together over other
/// frames, moving or static. One pose for each stamp of the moving link next to the child; the
/// links above it are taken at that stamp, turned and moved between their own (tf2), and waited for
/// 0.5 s of stamps. Transforms that come again with the same stamp are dropped. Thread-compatible.
class TfOdometry {
 public:
  /// @param parent  frame of the world
  /// @param child   frame of the sensor or body
  TfOdometry(std::string parent, std::string child);

  /// Poses that are ready now, in the order of their stamps.
  /// @param stream  kTf or kStaticTf
  /// @throws std::invalid_argument where the message is no tf2_msgs/TFMessage
  std::vector<OdometryInput> Read(const RawMessage& message, InputStream stream);
  std::vector<OdometryInput> Add(const std::vector<geometry_msgs::TransformStamped>& transforms,
                                 bool is_static);

  /// Transforms that came again, in the chain or not.
  long repeated() const { return repeated_; }
  /// Poses that were given up: a link above had no transform around their stamp.
  long unmatched() const { return unmatched_; }

  /// What is missing between the two frames, for the user: the frames that are known, and their
  /// parents.
  std::string Describe() const;

 private:
  bool Insert(const geometry_msgs::TransformStamped& transform, bool is_static);
  void ForgetMoving();
  std::vector<std::string> UpFrom(const std::string& frame) const;
  std::string SampledLink() const;
  bool Release(Stamp stamp, std::vector<OdometryInput>* ready) const;

  struct Link {
    std::string parent;
    bool is_static = false;
    Stamp newest = 0;
  };

  const std::string parent_, child_;
  tf2::BufferCore buffer_;
  std::map<std::string, Link> links_;  // by child, as last heard
  std::map<std::string, geometry_msgs::TransformStamped> static_transforms_;  // by child
  std::deque<Stamp> waiting_;  // poses whose stamps came
  Stamp newest_sampled_ = 0;
  long repeated_ = 0, unmatched_ = 0;
};

/// "/base_link" and "base_link" are the same frame.
std::string WithoutSlash(const std::string& frame);

}  // namespace odmc
