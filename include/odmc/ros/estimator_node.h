#pragma once

#include <ros/node_handle.h>
#include <ros/publisher.h>
#include <ros/service_server.h>

#include <chrono>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "odmc/estimator/acceptance.h"
#include "odmc/estimator/estimator.h"
#include "odmc/fleet/unlike_history.h"
#include "odmc/inspection/stream_watch.h"
#include "odmc/ros/background_looks.h"
#include "odmc/ros/estimate_publisher.h"
#include "odmc/ros/estimate_trust.h"
#include "odmc/ros/estimator_setup.h"
#include "odmc/ros/guarded.h"
#include "odmc/ros/input_queue.h"
#include "odmc/ros/learning_progress.h"
#include "odmc/ros/mount_lookup.h"
#include "odmc/ros/node_reporter.h"
#include "odmc/ros/rotor_supervision.h"
#include "odmc/ros/sample_intake.h"
#include "odmc/ros/topic_intake.h"

namespace odmc {

/// The estimator on ROS. Callbacks convert and push on a bounded queue, nothing else (TopicIntake,
/// InputQueue); one thread owns the estimator and publishes what it finds (EstimatePublisher);
/// another one reports once in a while (NodeReporter); a third one, of low priority, looks at what
/// the model leaves unexplained (BackgroundLooks). Stop(), or the destructor, works off what is
/// queued (for at most two seconds) and writes the result.
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

  // The thread of BackgroundLooks.
  void OnLook(const ResidualLook& look);

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
  void MakeEstimator();
  void HoldOut();
  void Feed(const Sample& sample);
  void Observe(const Sample& sample);
  void InspectStreams();
  void LearnOfReaction(const BackgroundLooks::StreamsFound& found);
  void StepWhileThereIsMore();
  void AddWhatWasFound();
  void ForgetEstimate(const char* why);
  void OnSnapshot(Snapshot snapshot);
  void Finish();

  // Estimator thread: what others are told.
  EstimatePublisher::Context ContextOfLast() const;
  EstimatePublisher::Frames FramesNow() const;
  void ShareStatus();
  void ShareIntake(NodeStatus* status) const;
  void ShareEstimator(NodeStatus* status) const;
  void ShareSnapshot(const Snapshot& snapshot, NodeStatus* status) const;
  std::string MissingStream() const;
  std::vector<std::string> UnlikeHistorySentences() const;

  // Set once in the constructor. The estimator thread completes the mounts of setup_.vehicle and
  // adds effects; of the vehicle the others read only name and rotors.
  EstimatorNodeSetup setup_;
  const std::vector<std::string> declared_effects_;  // of the vehicle file
  const std::map<std::string, ParameterSetting> declared_parameters_;
  ros::Publisher unexplained_publisher_;  // of the thread of BackgroundLooks
  std::vector<ros::ServiceServer> services_;

  // Shared by the threads; each guards itself.
  InputQueue queue_;
  Guarded<SharedStatus> shared_;

  // Of the estimator thread.
  MountLookup mounts_;
  SampleIntake intake_;
  RotorSupervision rotors_;
  std::optional<StreamWatch> streams_seen_;    // as they come, before they are mended
  std::shared_ptr<const DynamicModel> model_;  // others get it by shared_
  std::unique_ptr<Estimator> estimator_;
  EstimateTrust trust_;
  ReactionWatch reaction_watch_;
  Acceptance acceptance_;
  LearningProgress progress_;
  EstimatePublisher publisher_;
  std::optional<Snapshot> last_;
  std::shared_ptr<const DynamicModel> last_model_;  // of last_
  std::optional<HistoryWatch> history_watch_;       // where a fleet's flights were before
  std::vector<UnlikeHistory> unlike_history_;
  std::string added_effects_;
  bool stopped_by_clock_ = false, ignores_imu_ = false, frozen_ = false;
  long starts_anew_ = 0;  // of the estimator, as far as they are dealt with
  const Clock::time_point started_ = Clock::now();
  Clock::time_point status_shared_;
  std::deque<double> update_ms_, publish_ms_;
  long not_finite_ = 0;
  std::string failure_;  // read by others once the thread has been joined

  // Threads, started last and ended first; they use all of the above.
  std::thread estimator_thread_;
  std::unique_ptr<BackgroundLooks> looks_;
  std::unique_ptr<NodeReporter> reporter_;
  std::unique_ptr<TopicIntake> topics_;
};

}  // namespace odmc
