#pragma once

#include <ros/node_handle.h>
#include <ros/subscriber.h>

#include <array>
#include <chrono>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "odmc/ros/input_queue.h"
#include "odmc/ros/pose_twist.h"
#include "odmc/ros/streams.h"
#include "odmc/ros/tf_odometry.h"

namespace odmc {

/// Subscribes to the topics of the estimator, turns messages into samples and queues them, nothing
/// else. Its members are of the one ROS thread.
class TopicIntake {
 public:
  using Warn = std::function<void(const std::string&)>;

  /// @param with_commands whether anybody could make anything of motor commands
  /// @param queue outlives the intake
  /// @param warn may be called from the ROS thread
  TopicIntake(ros::NodeHandle node, const StreamOptions& options, int num_rotors,
              bool with_commands, InputQueue* queue, Warn warn);

  /// No message comes any more.
  void Stop();

 private:
  using Clock = std::chrono::steady_clock;

  bool IsWanted(InputStream stream, bool with_commands) const;
  void Subscribe(InputStream stream, int num_rotors);
  void Take(InputStream stream, const RawMessage& message, Stamp arrival, StreamReader* reader);
  void TakeTransforms(InputStream stream, const RawMessage& message);
  void NoteStamps(InputStream stream, const std::string& stamps);
  std::vector<InputSample> Paired(InputStream stream, InputSample input);
  void TellOfSigns(const InputSample& input);

  ros::NodeHandle node_;
  const StreamOptions options_;
  InputQueue* const queue_;
  const Warn warn_;
  PoseTwistPairing pairing_;
  std::optional<TfOdometry> tf_odometry_;  // where odometry comes from tf
  bool tf_leads_ = false;                  // from parent to child: poses have come
  Clock::time_point tf_described_;
  std::array<std::string, kNumInputStreams> stamps_;  // as noted in the queue
  bool told_of_signs_ = false, told_of_late_twists_ = false;
  std::vector<ros::Subscriber> subscribers_;
};

}  // namespace odmc
