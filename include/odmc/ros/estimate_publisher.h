#pragma once

#include <ros/node_handle.h>
#include <ros/publisher.h>
#include <tf2_ros/buffer.h>
#include <tf2_ros/transform_broadcaster.h>

#include <chrono>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "odmc/estimator/acceptance.h"
#include "odmc/estimator/snapshot.h"
#include "odmc/ros/displays.h"
#include "odmc/ros/estimator_setup.h"
#include "odmc/text/finding.h"

namespace odmc {

/// Publishes what the estimator found: messages, transforms, displays, each at its rate. Of the
/// estimator thread.
class EstimatePublisher {
 public:
  /// What a snapshot is published with.
  struct Context {
    const DynamicModel* model = nullptr;  ///< of the snapshot
    const Acceptance* acceptance = nullptr;
    const std::vector<Finding>* findings = nullptr;
    bool is_interrupted = false;  ///< nothing is learned at present
  };
  /// Names of frames in the messages that come in; empty where nobody says.
  struct Frames {
    std::string odometry, sensor, imu;
  };

  /// @param options, tf_buffer outlive the publisher
  EstimatePublisher(ros::NodeHandle node, ros::NodeHandle private_node,
                    const EstimatorNodeOptions* options, const tf2_ros::Buffer* tf_buffer);

  void SetFrames(const Frames& frames) { frames_ = frames; }

  /// A new estimate.
  void Publish(const Snapshot& snapshot, const Context& context);
  /// The estimate as it stands, where its throttle held it back or the vehicle does not fly.
  /// @param is_news it has changed since it was given last
  void PublishParameters(const Snapshot& snapshot, const Context& context, bool is_news = false);
  void PublishDisplays(const Snapshot& snapshot, const Context& context);
  /// What of the estimate is fit for use, as of `snapshot`.
  void PublishAccepted(const Snapshot& snapshot, const Context& context);
  /// Once for each phase of the flight.
  void PublishPhase(const std::string& phase);
  const std::string& phase() const { return phase_; }  ///< as published last

  /// The clock stepped back.
  void ClearPath() { trail_.Clear(); }

 private:
  using Clock = std::chrono::steady_clock;

  void PublishTransforms(const Snapshot& snapshot, const DynamicModel& model);
  void PublishBodyTransform(const Snapshot& snapshot);
  void PublishPlots(const Snapshot& snapshot, const DynamicModel& model);
  std::string WorldFrame() const;

  ros::NodeHandle private_node_;
  const EstimatorNodeOptions& options_;
  const tf2_ros::Buffer& tf_buffer_;
  ros::Publisher parameters_, accepted_, state_, wrench_, phase_publisher_, displays_,
      path_publisher_, plot_;
  std::map<std::string, std::pair<ros::Publisher, ros::Publisher>> plot_topics_;
  tf2_ros::TransformBroadcaster tf_broadcaster_;
  std::optional<bool> has_body_tf_;  // somebody else publishes it; known after a while
  PathTrail trail_;
  Frames frames_;
  std::string phase_;
  bool is_published_ = false;  // the newest estimate
  const Clock::time_point started_ = Clock::now();
  Clock::time_point parameters_published_, accepted_published_, displayed_;
};

}  // namespace odmc
