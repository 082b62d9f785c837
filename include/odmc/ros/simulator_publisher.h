#pragma once

#include <diagnostic_msgs/DiagnosticStatus.h>
#include <ros/node_handle.h>
#include <ros/publisher.h>
#include <tf2_ros/static_transform_broadcaster.h>
#include <tf2_ros/transform_broadcaster.h>

#include <string>
#include <vector>

#include "odmc/model/dynamic_model.h"
#include "odmc/sim/world.h"
#include "odmc/trajectory/trajectory.h"

namespace odmc {

/// Frames of what a simulated vehicle publishes.
struct SimulatorFrames {
  std::string world, body;    ///< as asked for
  std::string odometry, imu;  ///< of the sensors; the body's where they sit in it
  std::string truth;          ///< the body as it truly moves

  static SimulatorFrames Of(const Vehicle& vehicle, const std::string& world,
                            const std::string& body);
};

/// What a simulated vehicle says on ROS: clock, sensors' messages, reference, truth and
/// diagnostics. Every time passed is the world's, which begins at zero; on ROS it begins at
/// `epoch`. Used by one thread.
class SimulatorPublisher {
 public:
  /// @param publishes_clock false: stamps are of the machine's clock, and /clock is left alone
  SimulatorPublisher(ros::NodeHandle node, SimulatorFrames frames, Stamp epoch,
                     bool publishes_clock);

  bool somebody_takes_odometry() const { return odometry_.getNumSubscribers() > 0; }

  /// True parameters, the sensors' mounts, and where the trajectory ends its path.
  void PublishStart(const Vehicle& vehicle, const DynamicModel& model, const ModelValues& truth,
                    const Trajectory& trajectory, double ground_s);
  void PublishClock(Stamp now);
  void PublishSamples(const std::vector<Sample>& samples);
  void PublishReference(const FlatReference& reference, Stamp now);
  /// The same as a waypoint of `command_trajectory`.
  void PublishPoint(const FlatReference& reference, Stamp now);
  void PublishTruth(const TruthSample& truth, const Eigen::Vector3d& wind_W, Stamp now);
  void PublishTruthTransform(const TruthSample& truth, Stamp now);
  void PublishDiagnostics(const diagnostic_msgs::DiagnosticStatus& status, Stamp now);

 private:
  SimulatorFrames frames_;
  Stamp epoch_;
  bool publishes_clock_;
  ros::Publisher clock_, odometry_, imu_, rotors_, battery_, reference_, point_, path_,
      truth_odometry_, truth_wrench_, truth_wind_, truth_parameters_, diagnostics_;
  tf2_ros::TransformBroadcaster tf_;
  tf2_ros::StaticTransformBroadcaster static_tf_;
};

}  // namespace odmc
