#pragma once

#include <ros/node_handle.h>
#include <ros/publisher.h>
#include <ros/service_server.h>
#include <ros/subscriber.h>
#include <std_srvs/SetBool.h>
#include <std_srvs/Trigger.h>
#include <tf2_ros/buffer.h>
#include <tf2_ros/transform_broadcaster.h>
#include <tf2_ros/transform_listener.h>

#include <array>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <functional>
#include <future>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "odmc/actuator/rotor_source.h"
#include "odmc/attribution/residual_watch.h"
#include "odmc/estimator/acceptance.h"
#include "odmc/estimator/estimator.h"
#include "odmc/fleet/unlike_history.h"
#include "odmc/inspection/live_mender.h"
#include "odmc/inspection/stream_watch.h"
#include "odmc/ros/displays.h"
#include "odmc/ros/live_image.h"
#include "odmc/ros/node_status.h"
#include "odmc/ros/pose_twist.h"
#include "odmc/ros/sample_intake.h"
#include "odmc/ros/streams.h"
#include "odmc/ros/tf_odometry.h"

namespace odmc {

/// Private parameters of estimator_node, besides those of EstimatorOptions.
struct EstimatorNodeOptions : StreamOptions {
  std::string vehicle_file;     ///< vehicle YAML; empty: the URDF in robot_description
  std::string config;           ///< YAML of EstimatorOptions; empty: defaults
  std::string parameters_file;  ///< start values and priors from an earlier calibration
  double rotor_radius_m = 0.0;  ///< for a URDF whose propellers have no simple shape [m]
  std::string body_frame = "base_link";
  std::string twist_frame = "auto";         ///< auto | body | world
  std::string rotor_speed_from = "sensor";  ///< sensor | commands, by the actuator
  std::string actuator;  ///< file of calibrate_actuator; empty: that of the vehicle file
  std::string on_time_reset = "restart";  ///< restart | stop, where the clock steps back
  double publish_rate_hz = 20.0;          ///< of `parameters`, at most [Hz], > 0
  bool live_image = false;                ///< draw also while nobody listens
  double display_rate_hz = 10.0;  ///< of `~displays` and `~path`, at most [Hz], > 0
  double path_length_s = 60.0;    ///< flight time that `~path` looks back [s], > 0
  bool plot_topics = false;       ///< a topic per parameter below `~plot`
  /// never | auto | always: publish the body's pose as a transform; auto: where nobody else does.
  std::string body_tf = "never";
  std::string output_dir;                 ///< parameters.yaml goes there at the end; empty: none
  int queue_size = 20000;                 ///< samples waiting for the estimator, at most
  /// Effects the node may add to the model in flight once residual_watch_confirmations looks in a
  /// row found them; empty: none.
  std::vector<std::string> add_effects;
  ResidualWatchOptions residual_watch;
  AcceptanceOptions acceptance;

  template <typename Visitor>
  void Visit(Visitor* v) {
    v->Field("vehicle_file", &vehicle_file);
    v->Field("config", &config);
    v->Field("parameters_file", &parameters_file);
    v->Field("rotor_radius_m", &rotor_radius_m);
    v->Field("body_frame", &body_frame);
    v->Field("twist_frame", &twist_frame);
    StreamOptions::Visit(v);
    v->Field("rotor_speed_from", &rotor_speed_from);
    v->Field("actuator", &actuator);
    v->Field("on_time_reset", &on_time_reset);
    v->Field("publish_rate_hz", &publish_rate_hz);
    v->Field("live_image", &live_image);
    v->Field("display_rate_hz", &display_rate_hz);
    v->Field("path_length_s", &path_length_s);
    v->Field("plot_topics", &plot_topics);
    v->Field("body_tf", &body_tf);
    v->Field("output_dir", &output_dir);
    v->Field("queue_size", &queue_size);
    v->Field("add_effects", &add_effects);
    residual_watch.Visit(v);
    acceptance.Visit(v);
  }

  bool IsValid(std::string* error) const;
};

/// Everything the node reads before it starts.
struct EstimatorNodeSetup {
  EstimatorNodeOptions options;
  EstimatorOptions estimator;
  Vehicle vehicle;
  /// Priors of the vehicle file, with a thrust coefficient that an earlier flight knows.
  std::map<std::string, ParameterSetting> file_parameters;
  std::optional<ParameterSet> history;  ///< of a fleet's flights before, with their scatter
  bool odometry_mount_known = false;  ///< the vehicle file says where the odometry's sensor sits
  std::vector<std::string> warnings;  ///< for the user
};

/// Reads private parameters, configuration and vehicle.
/// @throws std::invalid_argument with a sentence for the user
EstimatorNodeSetup ReadEstimatorNodeSetup(const ros::NodeHandle& public_node,
                                          const ros::NodeHandle& private_node);

/// The estimator on ROS. Callbacks convert and push on a bounded queue, nothing else; one thread
/// owns the estimator and publishes what it finds; another one reports once in a while; a third
/// one, of low priority, looks at what the model leaves unexplained. Stop(), or the destructor,
/// works off what is queued (for at most two seconds) and writes the result.
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
  /// What a service has to say: whether it worked, and a sentence.
  using Answer = std::pair<bool, std::string>;

  // ROS threads.
  void Offer(ros::NodeHandle private_node);
  Answer Ask(std::function<Answer()> act);
  void Subscribe(InputStream stream);
  bool IsWanted(InputStream stream) const;
  void Take(InputStream stream, const RawMessage& message, Stamp arrival, StreamReader* reader);
  void TakeTransforms(InputStream stream, const RawMessage& message);
  void NoteStamps(InputStream stream, const std::string& stamps);
  std::vector<InputSample> Paired(InputStream stream, InputSample input);
  void Push(InputStream stream, std::vector<InputSample> inputs);
  void Refuse(InputStream stream, const std::string& refusal);
  void CountPassedOver(InputStream stream);
  void WarnOfSigns(const InputSample& input);

  // Estimator thread.
  void RunEstimator();
  bool WaitForInput(std::deque<InputSample>* batch);
  bool TakeBatch(std::deque<InputSample>* batch);
  void AnswerRequests();
  Answer Reset();
  Answer Freeze(bool freeze);
  Answer Accept();
  Answer SaveNow();
  void Process(std::deque<InputSample>* batch);
  void OnClockStepBack();
  void TryStart();
  bool ResolveMounts();
  std::optional<SensorMount> LookUpMount(const std::string& sensor_frame);
  void Start();
  void MakeEstimator();
  void HoldOut();
  void Feed(const Sample& sample);
  void FindVoltage(const std::vector<Sample>& samples);
  void Settle(const CommandSample& sample);
  void Settle(const RotorSample& sample);
  void TellFaults();
  void Observe(const Sample& sample);
  void StepWhileThereIsMore();
  void AddWhatWasFound();
  void ForgetEstimate(const char* why);
  void LookBack();
  void HandOverStreams();
  void AdoptInspection();
  void RenewFindings();
  void WidenForDoubts(Snapshot* snapshot) const;
  void PublishPhase();
  void OnSnapshot(Snapshot snapshot);
  void PublishEstimate(const Snapshot& snapshot);
  void PublishParameters(const Snapshot& snapshot);
  void PublishAccepted(const Snapshot& snapshot);
  void PublishTransforms(const Snapshot& snapshot);
  void PublishDisplays(const Snapshot& snapshot);
  void PublishBodyTransform(const Snapshot& snapshot);
  void PublishPlots(const Snapshot& snapshot);
  std::string WorldFrame() const;
  const std::string& SensorFrame() const;
  void ShareStatus();
  std::string Interruption();
  std::string MissingStream() const;
  void ShareSnapshot(const Snapshot& snapshot, NodeStatus* status) const;
  std::vector<std::string> UnlikeHistorySentences() const;
  RotorStatus RotorsNow() const;
  std::string TwistText() const;
  void Finish();
  std::string Save() const;
  void Warn(const std::string& sentence);
  void Tell(const std::string& sentence) const;

  // Watching thread.
  void RunWatching();
  void OnLook(const ResidualLook& look);
  void InspectStreamsIfDue();

  // Reporting thread.
  void RunReporting();
  NodeStatus Status();
  void PublishDiagnostics(const std::array<StreamStatus, kNumInputStreams>& streams,
                          const std::array<StreamStatus, kNumInputStreams>& before, size_t queued,
                          double seconds);
  void PublishLiveImage();

  // Set once in the constructor. The estimator thread completes the mounts of setup_.vehicle and
  // adds effects; of the vehicle the others read only name and rotors.
  EstimatorNodeSetup setup_;
  ros::NodeHandle node_, private_node_;
  ros::Publisher parameters_publisher_, accepted_publisher_, state_publisher_, wrench_publisher_,
      unexplained_publisher_, phase_publisher_, diagnostics_publisher_, image_publisher_,
      displays_publisher_, path_publisher_, plot_publisher_;
  tf2_ros::Buffer tf_buffer_;
  std::unique_ptr<tf2_ros::TransformListener> tf_listener_;
  std::vector<ros::Subscriber> subscribers_;
  // Of the one ROS thread.
  PoseTwistPairing pairing_;
  std::optional<TfOdometry> tf_odometry_;  // where odometry comes from tf
  bool tf_leads_ = false;                  // from parent to child: poses have come
  Clock::time_point tf_described_;
  std::array<std::string, kNumInputStreams> stamps_;  // as noted in streams_
  bool told_of_signs_ = false, told_of_late_twists_ = false;
  std::vector<ros::ServiceServer> services_;
  const std::vector<std::string> declared_effects_;  // of the vehicle file
  const std::map<std::string, ParameterSetting> declared_parameters_;

  // Guarded by queue_mutex_.
  std::mutex queue_mutex_;
  std::condition_variable queue_changed_, reporting_wakes_;
  std::deque<InputSample> queue_;
  std::deque<std::packaged_task<Answer()>> requests_;  // of services, for the estimator thread
  std::array<StreamStatus, kNumInputStreams> streams_;
  bool stopping_ = false;

  // Owned by the estimator thread.
  SampleIntake intake_;
  std::optional<RotorSource> rotor_source_;  // where the actuator is known
  std::map<int, RotorFault> bad_sensors_;    // by rotor
  long rotor_faults_ = 0;
  std::optional<Stamp> last_command_;
  bool has_voltage_ = false, has_commands_ = false;
  std::shared_ptr<const DynamicModel> model_;  // others get it by status_
  std::unique_ptr<Estimator> estimator_;
  Acceptance acceptance_;
  tf2_ros::TransformBroadcaster tf_broadcaster_;
  std::optional<bool> has_body_tf_;  // somebody else publishes it; known after a while
  PathTrail path_;
  Clock::time_point displayed_;
  std::map<std::string, std::pair<ros::Publisher, ros::Publisher>> plot_publishers_;
  std::optional<Clock::time_point> waiting_for_tf_since_;
  bool stopped_by_clock_ = false, ignores_imu_ = false, frozen_ = false;
  std::optional<Snapshot> last_;
  std::shared_ptr<const DynamicModel> last_model_;  // of last_
  std::optional<HistoryWatch> history_watch_;       // where a fleet's flights were before
  std::vector<UnlikeHistory> unlike_history_;
  std::string added_effects_;
  bool last_is_published_ = false;
  std::string phase_;      // as published last
  std::optional<StreamWatch> streams_seen_;  // as they come, before they are mended
  LiveMender mender_;
  std::shared_ptr<const DynamicModel> doubted_;  // whose parameters doubts_ are of
  std::vector<Eigen::VectorXd> doubts_;          // what each doubt may make of them
  std::set<std::string> told_;      // checks that were written to the log
  std::vector<Finding> look_back_;  // by the thirds of the flight
  std::vector<Finding> findings_;  // what is known against the estimate
  double last_look_s_ = 0.0;       // flight time of the last look at the thirds
  long starts_anew_ = 0;   // of the estimator, as far as they are dealt with
  Clock::time_point parameters_published_, accepted_published_, status_shared_;
  // What had been learned from when progress was last looked at, and where nothing has been since.
  EstimatorCounters progress_;
  Clock::time_point progress_looked_at_;
  std::string interrupted_;
  bool comes_on_ = false;  // keyframes did come
  const Clock::time_point started_ = Clock::now();
  std::deque<double> update_ms_, publish_ms_;
  long not_finite_ = 0;
  std::string failure_;  // read by others once the thread has been joined

  // Guarded by status_mutex_.
  std::mutex status_mutex_;
  NodeStatus status_;
  LiveHistory history_;

  // Made by the estimator thread at the start, for the watching thread to look; null: off.
  std::shared_ptr<ResidualWatch> watch_;     // guarded by watch_mutex_ while it is made
  std::optional<ResidualLook> to_be_added_;  // guarded by watch_mutex_
  /// The newest minute of the streams as they come, and what they are inspected for.
  struct StreamsSeen {
    FlightLog log;
    Vehicle vehicle;
    std::shared_ptr<const DynamicModel> model;
  };
  struct StreamsFound {
    StreamInspection inspection;
    std::shared_ptr<const DynamicModel> model;
    std::vector<Eigen::VectorXd> changes;  // of its parameters, without each doubt
  };
  std::optional<StreamsSeen> to_be_inspected_;  // guarded by watch_mutex_
  std::optional<StreamsFound> inspected_;       // guarded by watch_mutex_
  std::mutex watch_mutex_;

  // Started last, joined first.
  std::thread estimator_thread_, reporting_thread_, watching_thread_;
};

}  // namespace odmc
