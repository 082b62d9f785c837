#pragma once

#include <ros/node_handle.h>
#include <ros/publisher.h>
#include <ros/service_server.h>

#include <chrono>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "odmc/inspection/stream_watch.h"
#include "odmc/ros/background_analysis.h"
#include "odmc/ros/estimate_publisher.h"
#include "odmc/ros/estimate_session.h"
#include "odmc/ros/estimator_setup.h"
#include "odmc/ros/guarded.h"
#include "odmc/ros/input_queue.h"
#include "odmc/ros/mount_lookup.h"
#include "odmc/ros/node_reporter.h"
#include "odmc/ros/rotor_supervision.h"
#include "odmc/ros/sample_intake.h"
#include "odmc/ros/topic_intake.h"

namespace odmc {

/// The estimator on ROS. Callbacks convert and push on a bounded queue, nothing else (TopicIntake,
/// InputQueue); one thread owns the estimate (EstimateSession) and publishes it
/// (EstimatePublisher); another one reports once in a while (NodeReporter); a third one, of low
/// priority, looks at what the model leaves unexplained (BackgroundAnalysis). Stop(), or the
/// destructor, works off what is queued (for at most two seconds) and writes the result.
class EstimatorNode {
 public:
  EstimatorNode(const ros::NodeHandle& node, const ros::NodeHandle& private_node,
                EstimatorNodeSetup setup);
  ~EstimatorNode();
  /// Ends all threads and saves. @returns false if anything failed (said on stderr)
  bool Stop();
  EstimatorNode(const EstimatorNode&) = delete;
  EstimatorNode& operator=(const EstimatorNode&) = delete;

 private:
  using Clock = std::chrono::steady_clock;
  using Answer = InputQueue::Answer;

  // Any thread.
  void AdvertiseServices(ros::NodeHandle private_node);
  void Warn(const std::string& sentence);
  void Tell(const std::string& sentence) const;

  // The thread of BackgroundAnalysis.
  void OnLook(const ResidualAnalysis& look);

  // Estimator thread: services.
  Answer Reset();
  Answer Freeze(bool freeze);
  Answer Accept();
  Answer SaveNow();
  std::string Save() const;

  // Estimator thread: samples.
  void RunEstimator();
  void Process(std::deque<InputSample>* batch);
  void OnClockStepBack();
  void StartIfMountsAreKnown();
  void Start();
  void WatchResidual();
  void Feed(const Sample& sample);
  void Observe(const Sample& sample);
  void InspectStreams();
  void StepWhileThereIsMore();
  void AddWhatWasFound();
  void OnSnapshot(const Snapshot& snapshot);
  void Finish();

  // Estimator thread: what others are told.
  EstimatePublisher::Frames FramesNow() const;
  void ShareStatus();
  void ShareIntake(NodeStatus* status) const;
  void ShareEstimator(NodeStatus* status) const;
  std::string MissingStream() const;

  /// Of the newest updates, and since when.
  struct Timing {
    std::deque<double> update_ms, publish_ms;
    long not_finite = 0;  // estimates that were not published
    const Clock::time_point started = Clock::now();
    Clock::time_point status_shared;
  };

  // Set once in the constructor.
  const EstimatorNodeSetup setup_;
  ros::Publisher unexplained_publisher_;  // of the thread of BackgroundAnalysis
  std::vector<ros::ServiceServer> services_;

  // Shared by the threads; each guards itself.
  InputQueue queue_;
  Guarded<SharedStatus> shared_;

  // Of the estimator thread.
  MountLookup mounts_;
  SampleIntake intake_;
  RotorSupervision rotors_;
  std::optional<StreamWatch> streams_seen_;  // as they come, before they are mended
  EstimateSession session_;
  EstimatePublisher publisher_;
  bool stopped_by_clock_ = false, ignores_imu_ = false;
  Timing timing_;
  std::string failure_;  // read by others once the thread has been joined

  // Threads, started last and ended first; they use all of the above.
  std::thread estimator_thread_;
  std::unique_ptr<BackgroundAnalysis> looks_;
  std::unique_ptr<NodeReporter> reporter_;
  std::unique_ptr<TopicIntake> topics_;
};

}  // namespace odmc
