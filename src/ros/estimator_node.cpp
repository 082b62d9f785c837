#include "odmc/ros/estimator_node.h"

#include <diagnostic_msgs/DiagnosticArray.h>
#include <ros/console.h>
#include <ros/init.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/image_encodings.h>
#include <std_msgs/Float64.h>
#include <std_msgs/String.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>
#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <filesystem>
#include <iterator>
#include <stdexcept>
#include <utility>

#include "odmc/analysis/calibration.h"
#include "odmc/analysis/phase_findings.h"
#include "odmc/inspection/recording_inspection.h"
#include "odmc/io/actuator_yaml.h"
#include "odmc/io/options_yaml.h"
#include "odmc/io/parameters_yaml.h"
#include "odmc/io/printable_text.h"
#include "odmc/io/vehicle_yaml.h"
#include "odmc/math/statistics.h"
#include "odmc/model/plausibility.h"
#include "odmc/ros/conversions.h"
#include "odmc/ros/diagnostic_values.h"
#include "odmc/ros/estimate_messages.h"
#include "odmc/ros/parameter_reader.h"
#include "odmc/ros/urdf_vehicle.h"

namespace odmc {
namespace {

constexpr std::chrono::milliseconds kIdle(100);
constexpr std::chrono::milliseconds kReportPeriod(500);  // image; diagnostics every other time
constexpr std::chrono::milliseconds kStatusPeriod(100);
constexpr std::chrono::milliseconds kProgressPeriod(1500);
constexpr std::chrono::seconds kLongWait(5);
constexpr std::chrono::milliseconds kWatchIdle(200);
constexpr double kDoubted_s = 20.0;  // of flight that is replayed without each doubt
constexpr std::chrono::milliseconds kAcceptedPeriod(500);
constexpr std::chrono::seconds kAnswerPatience(5);
constexpr std::chrono::seconds kTfPatience(2);
constexpr std::chrono::seconds kFinishPatience(2);
constexpr int kWatchNiceness = 10;
constexpr double kCommandsLost_s = 0.5;  // RotorSource then watches no longer
constexpr size_t kBatch = 300;           // samples taken from the queue at once
constexpr size_t kTimedUpdates = 1000;   // the percentiles look back this far
constexpr double kPathSpacing_s = 0.05;
constexpr char kCalibrated[] = "_calibrated";

/// Date and time in ISO 8601, UTC.
std::string Now() {
  const std::time_t now = std::time(nullptr);
  std::tm parts{};
  gmtime_r(&now, &parts);
  char text[32];
  std::strftime(text, sizeof text, "%Y-%m-%dT%H:%M:%SZ", &parts);
  return text;
}

/// Keeps the newest kTimedUpdates.
void Keep(double ms, std::deque<double>* all) {
  all->push_back(ms);
  if (all->size() > kTimedUpdates) all->pop_front();
}

double Percentile(const std::deque<double>& values, double share) {
  if (values.empty()) return 0.0;
  std::vector<double> sorted(values.begin(), values.end());
  const auto index = static_cast<std::ptrdiff_t>(share * static_cast<double>(sorted.size() - 1));
  std::nth_element(sorted.begin(), sorted.begin() + index, sorted.end());
  return sorted[index];
}

bool FileHasKey(const std::string& file, const std::string& key) {
  return YAML::LoadFile(file)[key].IsDefined();
}

/// An estimated mount's effect has a parameter that is not frozen.
bool IsEstimated(const DynamicModel& model, const std::string& effect) {
  return std::any_of(model.parameters().begin(), model.parameters().end(),
                     [&](const ModelParameter& p) { return p.effect == effect && p.estimated; });
}

sensor_msgs::Image ToMessage(const cv::Mat& image) {
  sensor_msgs::Image m;
  m.header.stamp = ros::Time::now();
  m.height = static_cast<std::uint32_t>(image.rows);
  m.width = static_cast<std::uint32_t>(image.cols);
  m.encoding = sensor_msgs::image_encodings::BGR8;
  m.step = static_cast<std::uint32_t>(image.cols * image.elemSize());
  m.data.assign(image.datastart, image.dataend);
  return m;
}

Vehicle ReadVehicle(const EstimatorNodeOptions& options, const ros::NodeHandle& node) {
  if (!options.vehicle_file.empty()) return LoadVehicle(options.vehicle_file);
  std::string urdf, name;
  if (!node.searchParam("robot_description", name) || !node.getParam(name, urdf)) {
    throw std::invalid_argument(
        "no vehicle: set the parameter vehicle_file to a vehicle YAML or give a URDF in "
        "robot_description");
  }
  return VehicleFromUrdf(urdf, options.rotor_radius_m);
}

/// Puts the actuator of the parameter in place of the vehicle file's and sees whether the node can
/// use what there is.
void SettleActuator(const EstimatorNodeOptions& options, Vehicle* vehicle) {
  const std::string& file = options.actuator;
  const bool from_commands = options.rotor_speed_from == "commands";
  std::string source = "the vehicle file's actuator: ";
  try {
    if (!file.empty()) {
      source = "parameter actuator: ";
      vehicle->actuator = LoadActuator(file);
      source += file + ": ";
    }
    // Steady readings can't watch a sensor; what the vehicle file knows beyond that still counts.
    const bool is_used =
        from_commands || !file.empty() || (vehicle->actuator && vehicle->actuator->knows_dynamics);
    if (vehicle->actuator && is_used) {
      RotorSource(*vehicle->actuator, vehicle->num_rotors(), from_commands);
    }
  } catch (const std::invalid_argument& e) {
    throw std::invalid_argument(source + e.what());
  }
  if (from_commands && !vehicle->actuator) {
    throw std::invalid_argument(
        "parameter rotor_speed_from is commands, but the actuator is not known: set the parameter "
        "actuator to an actuator.yaml of calibrate_actuator, or name it in the vehicle file");
  }
}

RotorIntake IntakeOf(const EstimatorNodeSetup& setup) {
  const bool from_commands = setup.options.rotor_speed_from == "commands";
  return {from_commands, from_commands && setup.vehicle.actuator->uses_voltage};
}

/// True if the file has parameters that were accepted when they were saved.
bool IsAcceptedFile(const std::string& file) {
  if (!std::filesystem::exists(file)) return false;
  try {
    const ParameterSet set = LoadParameters(file);
    const auto accepted = set.provenance.find("accepted");
    return accepted != set.provenance.end() && accepted->second == "true";
  } catch (const std::exception&) {
    return false;  // of no use to anybody
  }
}

}  // namespace

// ---- Set-up ------------------------------------------------------------------------------------

bool EstimatorNodeOptions::IsValid(std::string* error) const {
  const auto fail = [error](const std::string& what) {
    if (error != nullptr) *error = what;
    return false;
  };
  if (twist_frame != "auto" && twist_frame != "body" && twist_frame != "world") {
    return fail("twist_frame must be auto, body or world, not '" + twist_frame + "'");
  }
  if (rotor_speed_from != "sensor" && rotor_speed_from != "commands") {
    return fail("rotor_speed_from must be sensor or commands, not '" + rotor_speed_from + "'");
  }
  if (on_time_reset != "restart" && on_time_reset != "stop") {
    return fail("on_time_reset must be restart or stop, not '" + on_time_reset + "'");
  }
  if (!(publish_rate_hz > 0.0)) return fail("publish_rate_hz must be positive");
  if (!(display_rate_hz > 0.0)) return fail("display_rate_hz must be positive");
  if (!(path_length_s > 0.0)) return fail("path_length_s must be positive");
  if (body_tf != "never" && body_tf != "auto" && body_tf != "always") {
    return fail("body_tf must be never, auto or always, not '" + body_tf + "'");
  }
  if (queue_size < 100) return fail("queue_size must be at least 100");
  if (rotor_radius_m < 0.0) return fail("rotor_radius_m must not be negative");
  if (body_frame.empty()) return fail("body_frame must not be empty");
  for (const std::string& effect : add_effects) {
    if (!EffectRegistry::Default().Has(effect)) {
      return fail("add_effects: there is no effect '" + effect + "' (see list_effects)");
    }
  }
  return residual_watch.IsValid(error) && acceptance.IsValid(error);
}

EstimatorNodeSetup ReadEstimatorNodeSetup(const ros::NodeHandle& public_node,
                                          const ros::NodeHandle& private_node) {
  EstimatorNodeSetup setup;
  ParameterReader reader(private_node);
  setup.options.Visit(&reader);
  if (!setup.options.config.empty()) LoadOptions(setup.options.config, &setup.estimator);
  setup.estimator.Visit(&reader);
  reader.CheckAllRead();
  std::string error;
  if (!setup.options.IsValid(&error) || !setup.estimator.IsValid(&error)) {
    throw std::invalid_argument(private_node.getNamespace() + ": " + error);
  }
  setup.vehicle = ReadVehicle(setup.options, public_node);
  setup.options.Check(setup.vehicle.num_rotors());
  const std::string doubt = InertiaDoubt(setup.vehicle);
  if (!doubt.empty()) setup.warnings.push_back(doubt);
  setup.odometry_mount_known =
      !setup.options.vehicle_file.empty() && FileHasKey(setup.options.vehicle_file, "odometry");
  setup.file_parameters = setup.vehicle.parameters;
  if (!setup.options.parameters_file.empty()) {
    const ParameterSet set = LoadParameters(setup.options.parameters_file);
    const auto accepted = set.provenance.find("accepted");
    if (accepted != set.provenance.end() && accepted->second != "true") {
      setup.warnings.push_back(setup.options.parameters_file +
                               ": was not accepted when it was saved; the estimate starts from it");
    }
    ApplyParameters(set, &setup.vehicle);
    const bool is_fleet =
        std::any_of(set.parameters.begin(), set.parameters.end(),
                    [](const ParameterEstimate& p) { return p.scatter > 0.0; });
    if (is_fleet) setup.history = set;
    const auto known = setup.vehicle.parameters.find("thrust.k_f");
    if (known != setup.vehicle.parameters.end()) {
      setup.file_parameters.insert_or_assign(known->first, known->second);
    }
  }
  SettleActuator(setup.options, &setup.vehicle);
  if (!setup.options.output_dir.empty()) {
    std::error_code failed;
    std::filesystem::create_directories(setup.options.output_dir, failed);
    if (failed) {
      throw std::invalid_argument("output_dir " + setup.options.output_dir +
                                  " cannot be made: " + failed.message());
    }
  }
  return setup;
}

EstimatorNode::EstimatorNode(const ros::NodeHandle& node, const ros::NodeHandle& private_node,
                             EstimatorNodeSetup setup)
    : setup_(std::move(setup)),
      node_(node),
      private_node_(private_node),
      declared_effects_(setup_.vehicle.effects),
      declared_parameters_(setup_.vehicle.parameters),
      intake_(setup_.options.twist_frame, IntakeOf(setup_)),
      acceptance_(setup_.options.acceptance),
      path_(setup_.options.path_length_s, kPathSpacing_s) {
  parameters_publisher_ = node_.advertise<DynamicParameters>("parameters", 10);
  accepted_publisher_ = node_.advertise<DynamicParameters>("parameters_accepted", 1, true);
  state_publisher_ = node_.advertise<nav_msgs::Odometry>("state", 10);
  wrench_publisher_ = node_.advertise<geometry_msgs::WrenchStamped>("residual_wrench", 10);
  unexplained_publisher_ = node_.advertise<UnexplainedResidual>("unexplained", 10);
  phase_publisher_ = node_.advertise<std_msgs::String>("phase", 10, true);
  diagnostics_publisher_ = node_.advertise<diagnostic_msgs::DiagnosticArray>("/diagnostics", 10);
  image_publisher_ = node_.advertise<sensor_msgs::Image>("live_image", 1);
  displays_publisher_ =
      private_node_.advertise<visualization_msgs::MarkerArray>("displays", 10);
  path_publisher_ = private_node_.advertise<nav_msgs::Path>("path", 10);
  plot_publisher_ = private_node_.advertise<sensor_msgs::JointState>("estimates_plot", 10);
  tf_listener_ = std::make_unique<tf2_ros::TransformListener>(tf_buffer_);
  const EstimatorNodeOptions& options = setup_.options;
  if (options.uses_tf()) {
    tf_odometry_.emplace(options.odometry_tf_parent, options.odometry_tf_child);
  }
  if (setup_.history) history_watch_.emplace(*setup_.history);
  const std::optional<Actuator>& actuator = setup_.vehicle.actuator;
  if (actuator && actuator->knows_dynamics) {
    rotor_source_.emplace(*actuator, setup_.vehicle.num_rotors(), IntakeOf(setup_).from_commands);
    status_.rotors = RotorsNow();
  }
  status_.waiting_for = intake_.WaitingFor();
  for (const std::string& sentence : setup_.warnings) Warn(sentence);
  const bool watches = setup_.options.residual_watch.residual_watch_period_s > 0.0;
  status_.watches_residual = watches;
  estimator_thread_ = std::thread(&EstimatorNode::RunEstimator, this);
  reporting_thread_ = std::thread(&EstimatorNode::RunReporting, this);
  watching_thread_ = std::thread(&EstimatorNode::RunWatching, this);
  for (const StreamRole& role : StreamRoles()) {
    if (IsWanted(role.stream)) Subscribe(role.stream);
  }
  Offer(private_node);
}

EstimatorNode::~EstimatorNode() { Stop(); }

bool EstimatorNode::Stop() {
  if (!estimator_thread_.joinable()) return failure_.empty();
  for (ros::Subscriber& subscriber : subscribers_) subscriber.shutdown();
  {
    const std::lock_guard<std::mutex> lock(queue_mutex_);
    stopping_ = true;
  }
  queue_changed_.notify_all();
  reporting_wakes_.notify_all();
  estimator_thread_.join();
  reporting_thread_.join();
  if (watching_thread_.joinable()) watching_thread_.join();
  return failure_.empty();
}

// ---- ROS threads -------------------------------------------------------------------------------

bool EstimatorNode::IsWanted(InputStream stream) const {
  // Nobody could make anything of commands without the actuator.
  if (stream == InputStream::kMotorCommands) return rotor_source_.has_value();
  if (IsTf(stream)) return tf_odometry_.has_value();
  const bool is_motion = stream == InputStream::kOdometry || stream == InputStream::kPose;
  return !is_motion || !tf_odometry_;
}

/// Topics may have messages of any type: publishers bring the definition with them.
void EstimatorNode::Subscribe(InputStream stream) {
  const auto reader =
      std::make_shared<StreamReader>(stream, setup_.options, setup_.vehicle.num_rotors());
  const boost::function<void(const ros::MessageEvent<const RawMessage>&)> callback =
      [this, stream, reader](const ros::MessageEvent<const RawMessage>& event) {
        Take(stream, *event.getConstMessage(), FromRos(event.getReceiptTime()), reader.get());
      };
  ros::SubscribeOptions options;
  const std::string topic = (IsTf(stream) ? "/" : "") + std::string(NameOf(stream));
  options.initByFullCallbackType<const ros::MessageEvent<const RawMessage>&>(topic, 2000,
                                                                            callback);
  options.transport_hints = ros::TransportHints().tcpNoDelay();
  subscribers_.push_back(node_.subscribe(options));
}

void EstimatorNode::Take(InputStream stream, const RawMessage& message, Stamp arrival,
                         StreamReader* reader) {
  try {
    if (IsTf(stream)) return TakeTransforms(stream, message);
    std::optional<InputSample> input = reader->Read(message, arrival);
    for (const std::string& note : reader->TakeNotes()) {
      Warn(std::string(NameOf(stream)) + ": " + Printable(note));
    }
    if (!input) return CountPassedOver(stream);
    NoteStamps(stream, reader->stamp_source());
    WarnOfSigns(*input);
    std::optional<InputSample> accepted = Accepted(*std::move(input));
    if (!accepted) return Refuse(stream, "");
    Push(stream, Paired(stream, *std::move(accepted)));
  } catch (const std::exception& e) {
    const std::string refusal = Printable(e.what());
    ROS_WARN_THROTTLE(10.0, "%s: %s", NameOf(stream), refusal.c_str());
    Refuse(stream, refusal);
  }
}

/// Poses that a message of tf completes.
void EstimatorNode::TakeTransforms(InputStream stream, const RawMessage& message) {
  std::vector<InputSample> ready;
  for (OdometryInput& pose : tf_odometry_->Read(message, stream)) {
    std::optional<InputSample> accepted = Accepted(InputSample(std::move(pose)));
    if (!accepted) continue;
    for (InputSample& sample : Paired(InputStream::kPose, *std::move(accepted))) {
      ready.push_back(std::move(sample));
    }
    tf_leads_ = true;
  }
  const Clock::time_point now = Clock::now();
  if (!tf_leads_ && now - tf_described_ > kTfPatience) {
    tf_described_ = now;
    const std::lock_guard<std::mutex> lock(queue_mutex_);
    streams_[static_cast<size_t>(InputStream::kTf)].refusal = Printable(tf_odometry_->Describe());
  } else if (tf_leads_ && stream == InputStream::kTf) {
    NoteStamps(stream, "those of tf");
  }
  Push(stream, std::move(ready));
}

void EstimatorNode::NoteStamps(InputStream stream, const std::string& stamps) {
  std::string& noted = stamps_[static_cast<size_t>(stream)];
  if (noted == stamps) return;
  noted = stamps;
  const std::lock_guard<std::mutex> lock(queue_mutex_);
  StreamStatus& status = streams_[static_cast<size_t>(stream)];
  status.stamps = stamps;
  if (IsTf(stream)) status.refusal.clear();  // the frames hang together now
}

/// What is ready for the queue: poses may have to wait for the twist after them.
std::vector<InputSample> EstimatorNode::Paired(InputStream stream, InputSample input) {
  if (stream != InputStream::kPose && stream != InputStream::kTwist) return {std::move(input)};
  auto& one = std::get<OdometryInput>(input);
  const bool is_pose = stream == InputStream::kPose;
  std::vector<OdometryInput> ready =
      is_pose ? pairing_.AddPose(std::move(one)) : pairing_.AddTwist(std::move(one));
  if (pairing_.is_late() && !std::exchange(told_of_late_twists_, true)) {
    Warn("twist began later than pose: its velocity is not used; start the node once both come");
  }
  return {std::make_move_iterator(ready.begin()), std::make_move_iterator(ready.end())};
}

void EstimatorNode::WarnOfSigns(const InputSample& input) {
  const auto* rotors = std::get_if<RotorInput>(&input);
  if (told_of_signs_ || rotors == nullptr || !(rotors->sample.speed.minCoeff() < 0.0)) return;
  told_of_signs_ = true;
  ROS_INFO("rotor speeds have a sign: their magnitude is used, the direction of turning comes from "
           "the vehicle file");
}

void EstimatorNode::CountPassedOver(InputStream stream) {
  const std::lock_guard<std::mutex> lock(queue_mutex_);
  StreamStatus& status = streams_[static_cast<size_t>(stream)];
  ++status.received;
  ++status.passed_over;
}

void EstimatorNode::Refuse(InputStream stream, const std::string& refusal) {
  const std::lock_guard<std::mutex> lock(queue_mutex_);
  StreamStatus& status = streams_[static_cast<size_t>(stream)];
  ++status.received;
  ++status.refused;
  status.refusal = refusal;
}

/// Counts a message and queues what came of it.
void EstimatorNode::Push(InputStream stream, std::vector<InputSample> inputs) {
  const std::lock_guard<std::mutex> lock(queue_mutex_);
  StreamStatus& status = streams_[static_cast<size_t>(stream)];
  ++status.received;
  for (InputSample& input : inputs) {
    if (queue_.size() >= static_cast<size_t>(setup_.options.queue_size)) {
      ++status.overflowed;
    } else {
      queue_.push_back(std::move(input));
      queue_changed_.notify_one();
    }
  }
}

void EstimatorNode::Offer(ros::NodeHandle private_node) {
  using std_srvs::SetBool;
  using std_srvs::Trigger;
  const auto trigger = [&](const std::string& name, Answer (EstimatorNode::*act)()) {
    const boost::function<bool(Trigger::Request&, Trigger::Response&)> callback =
        [this, act](Trigger::Request&, Trigger::Response& response) {
          const Answer answer = Ask([this, act] { return (this->*act)(); });
          response.success = answer.first;
          response.message = answer.second;
          return true;
        };
    services_.push_back(private_node.advertiseService(name, callback));
  };
  trigger("reset", &EstimatorNode::Reset);
  trigger("accept", &EstimatorNode::Accept);
  trigger("save", &EstimatorNode::SaveNow);
  const boost::function<bool(SetBool::Request&, SetBool::Response&)> freeze =
      [this](SetBool::Request& request, SetBool::Response& response) {
        const bool on = request.data;
        const Answer answer = Ask([this, on] { return Freeze(on); });
        response.success = answer.first;
        response.message = answer.second;
        return true;
      };
  services_.push_back(private_node.advertiseService("freeze", freeze));
}

// Has the estimator thread do it, between two batches of samples.
EstimatorNode::Answer EstimatorNode::Ask(std::function<Answer()> act) {
  std::packaged_task<Answer()> task(std::move(act));
  std::future<Answer> answer = task.get_future();
  {
    const std::lock_guard<std::mutex> lock(queue_mutex_);
    requests_.push_back(std::move(task));
  }
  queue_changed_.notify_one();
  if (answer.wait_for(kAnswerPatience) != std::future_status::ready) {
    return {false, "the estimator does not answer"};
  }
  try {
    return answer.get();
  } catch (const std::exception& e) {
    return {false, e.what()};
  }
}

// ---- Estimator thread --------------------------------------------------------------------------

void EstimatorNode::AnswerRequests() {
  std::deque<std::packaged_task<Answer()>> requests;
  {
    const std::lock_guard<std::mutex> lock(queue_mutex_);
    requests.swap(requests_);
  }
  for (auto& request : requests) request();
}

EstimatorNode::Answer EstimatorNode::Reset() {
  if (!estimator_) return {false, "nothing is estimated yet"};
  setup_.vehicle.effects = declared_effects_;
  setup_.vehicle.parameters = declared_parameters_;
  MakeEstimator();
  acceptance_.Reset();
  last_.reset();
  if (history_watch_) history_watch_->Reset();
  added_effects_.clear();
  update_ms_.clear();
  publish_ms_.clear();
  {
    const std::lock_guard<std::mutex> lock(watch_mutex_);
    to_be_added_.reset();
  }
  const std::lock_guard<std::mutex> lock(status_mutex_);
  status_.model = model_;
  status_.observable.clear();
  status_.unphysical.clear();
  status_.unlike_history.clear();
  status_.unobservable.clear();
  status_.added_effects.clear();
  status_.unexplained.reset();
  history_.Clear();
  ROS_INFO("reset: the estimator starts anew");
  return {true, "the estimator starts anew"};
}

EstimatorNode::Answer EstimatorNode::Freeze(bool freeze) {
  frozen_ = freeze;
  HoldOut();
  const std::lock_guard<std::mutex> lock(status_mutex_);
  status_.frozen = freeze;
  return {true, freeze ? "nothing more is learned" : "learning goes on"};
}

void EstimatorNode::HoldOut() {
  if (!estimator_) return;
  estimator_->SetHeldOut(frozen_ ? [](Stamp) { return true; } : std::function<bool(Stamp)>());
}

EstimatorNode::Answer EstimatorNode::Accept() {
  const Snapshot& usable = acceptance_.Usable();
  if (!last_ || usable.values.size() != last_->values.size()) {
    return {false, "nothing is estimated yet"};
  }
  const std::vector<std::string> reasons =
      UnphysicalValues(*last_model_, usable.values, usable.sigma);
  if (!reasons.empty()) return {false, Join(reasons)};
  PublishAccepted(*last_);
  return {true, "the present estimate is published as accepted"};
}

EstimatorNode::Answer EstimatorNode::SaveNow() {
  if (setup_.options.output_dir.empty()) return {false, "output_dir is not set"};
  if (!last_) return {false, "nothing is estimated yet"};
  return {true, Save()};
}

void EstimatorNode::RunEstimator() {
  try {
    std::deque<InputSample> batch;
    while (WaitForInput(&batch)) {
      AnswerRequests();
      Process(&batch);
      AddWhatWasFound();
      // What the throttle held back is still news once nothing more comes.
      if (last_) PublishParameters(*last_);
      ShareStatus();
    }
    Finish();
  } catch (const std::exception& e) {
    failure_ = std::string("the estimator stopped: ") + e.what();
    Tell(failure_);
    const std::lock_guard<std::mutex> lock(status_mutex_);
    status_.fatal = failure_;
  }
}

bool EstimatorNode::WaitForInput(std::deque<InputSample>* batch) {
  {
    std::unique_lock<std::mutex> lock(queue_mutex_);
    queue_changed_.wait_for(lock, kIdle,
                            [this] { return stopping_ || !queue_.empty() || !requests_.empty(); });
    if (stopping_) return false;
  }
  TakeBatch(batch);
  return true;
}

bool EstimatorNode::TakeBatch(std::deque<InputSample>* batch) {
  const std::lock_guard<std::mutex> lock(queue_mutex_);
  // Not all at once: a long batch would hide the queue's length and delay the end.
  const auto end = queue_.begin() + static_cast<std::ptrdiff_t>(std::min(queue_.size(), kBatch));
  batch->assign(std::make_move_iterator(queue_.begin()), std::make_move_iterator(end));
  queue_.erase(queue_.begin(), end);
  return !batch->empty();
}

void EstimatorNode::Process(std::deque<InputSample>* batch) {
  for (InputSample& input : *batch) {
    if (stopped_by_clock_) break;
    if (!intake_.Push(std::move(input))) OnClockStepBack();
    if (intake_.phase() == IntakePhase::kHolding && intake_.decided()) TryStart();
  }
  batch->clear();
  if (!estimator_ || stopped_by_clock_) return;
  const std::vector<Sample> samples = intake_.Take();
  FindVoltage(samples);
  for (const Sample& sample : samples) Feed(sample);
}

void EstimatorNode::OnClockStepBack() {
  const bool stop = setup_.options.on_time_reset == "stop";
  ROS_WARN("the clock stepped back: %s", stop ? "the estimate stops here (on_time_reset: stop)"
                                              : "starting a new chain, parameters are kept");
  if (stop) {
    stopped_by_clock_ = true;
    const std::lock_guard<std::mutex> lock(status_mutex_);
    status_.fatal = "the clock stepped back and on_time_reset is stop";
  } else if (estimator_) {
    estimator_->RestartChain();
    if (rotor_source_) rotor_source_->Restart();
    last_command_.reset();
    acceptance_.Reset();
    if (watch_) watch_->Clear();
    if (streams_seen_) streams_seen_->Clear();
    path_.Clear();
    const std::lock_guard<std::mutex> lock(status_mutex_);
    history_.Clear();  // its time axis would run backwards
  }
}

void EstimatorNode::TryStart() {
  if (ResolveMounts()) Start();
}

bool EstimatorNode::ResolveMounts() {
  const Clock::time_point now = Clock::now();
  if (!waiting_for_tf_since_) waiting_for_tf_since_ = now;
  const bool patient = now - *waiting_for_tf_since_ < kTfPatience;
  Vehicle& vehicle = setup_.vehicle;
  const std::string& odometry_frame = SensorFrame();
  std::optional<SensorMount> odometry, imu;
  const bool needs_odometry = !setup_.odometry_mount_known && !odometry_frame.empty();
  const bool needs_imu = !vehicle.imu && intake_.imu_frame_id();
  if (needs_odometry) odometry = LookUpMount(odometry_frame);
  if (needs_imu) imu = LookUpMount(*intake_.imu_frame_id());
  if (patient && ((needs_odometry && !odometry) || (needs_imu && !imu))) return false;
  if (odometry) {
    odometry->estimate = vehicle.odometry.estimate;
    vehicle.odometry = *odometry;
  } else if (needs_odometry) {
    Warn("tf has no transform from " + setup_.options.body_frame + " to " + odometry_frame +
         " and the vehicle file says nothing: took the odometry's pose for the body's");
  }
  if (imu) {
    vehicle.imu = imu;
  } else if (needs_imu) {
    Warn("tf has no transform from " + setup_.options.body_frame + " to " +
         *intake_.imu_frame_id() +
         " and the vehicle file says nothing: took the IMU to be along "
         "the body at its origin");
  }
  ignores_imu_ = !vehicle.imu && !intake_.imu_frame_id();
  return true;
}

std::optional<SensorMount> EstimatorNode::LookUpMount(const std::string& sensor_frame) {
  SensorMount mount;
  if (sensor_frame == setup_.options.body_frame || sensor_frame.empty()) return mount;
  try {
    const geometry_msgs::TransformStamped m =
        tf_buffer_.lookupTransform(setup_.options.body_frame, sensor_frame, ros::Time(0));
    const auto& p = m.transform.translation;
    const auto& q = m.transform.rotation;
    mount.p_BS = Eigen::Vector3d(p.x, p.y, p.z);
    mount.q_BS = Eigen::Quaterniond(q.w, q.x, q.y, q.z).normalized();
    return mount;
  } catch (const tf2::TransformException&) {
    return std::nullopt;
  }
}

void EstimatorNode::MakeEstimator() {
  model_ = std::make_shared<DynamicModel>(setup_.vehicle, setup_.vehicle.effects);
  estimator_ = std::make_unique<Estimator>(model_.get(), setup_.estimator, !intake_.rms_only());
  starts_anew_ = 0;
  HoldOut();
  if (!streams_seen_) streams_seen_.emplace(setup_.vehicle);
  if (setup_.options.residual_watch.residual_watch_period_s > 0.0) {
    const std::lock_guard<std::mutex> lock(watch_mutex_);
    Vehicle filed = setup_.vehicle;
    filed.parameters = setup_.file_parameters;
    watch_ = std::make_shared<ResidualWatch>(filed, setup_.options.residual_watch,
                                             !intake_.rms_only());
  }
}

void EstimatorNode::Start() {
  MakeEstimator();
  if (intake_.rms_only()) {
    Warn("rotor speeds are root mean squares: force is estimated, torque is not");
  }
  if (!intake_.uses_pose() && !intake_.has_velocity()) Warn("the odometry has no linear twist");
  if (!intake_.uses_pose() && !intake_.has_rates()) Warn("the odometry has no angular twist");
  intake_.Release();
  ROS_INFO("estimating %s from %s%s%s", setup_.vehicle.name.c_str(),
           intake_.uses_pose() ? "poses" : "odometry",
           intake_.frame() == TwistFrame::kWorld ? ", twist in the world frame" : "",
           IntakeOf(setup_).from_commands ? ", rotor speeds from commands" : "");
}

// The first voltage stands in for those before it, as in recorded flights.
void EstimatorNode::FindVoltage(const std::vector<Sample>& samples) {
  if (!rotor_source_ || has_voltage_) return;
  for (const Sample& sample : samples) {
    const auto* battery = std::get_if<BatterySample>(&sample);
    if (battery == nullptr || !(battery->voltage_V > 0.0)) continue;
    rotor_source_->Add(*battery);
    has_voltage_ = true;
    return;
  }
}

void EstimatorNode::Feed(const Sample& sample) {
  if (const auto* command = std::get_if<CommandSample>(&sample)) {
    Settle(*command);
  } else if (const auto* rotors = std::get_if<RotorSample>(&sample)) {
    Settle(*rotors);
  } else {
    const auto* battery = std::get_if<BatterySample>(&sample);
    if (battery != nullptr && rotor_source_) rotor_source_->Add(*battery);
    Observe(sample);
  }
}

void EstimatorNode::Settle(const CommandSample& sample) {
  if (!rotor_source_) return;
  last_command_ = sample.stamp;
  if (const std::optional<RotorSample> modelled = rotor_source_->Add(sample)) Observe(*modelled);
}

void EstimatorNode::Settle(const RotorSample& sample) {
  // Of the root mean square of all rotors no single one can be told to be bad.
  if (!rotor_source_ || intake_.rms_only()) return Observe(sample);
  has_commands_ = last_command_ && ToSeconds(sample.stamp - *last_command_) < kCommandsLost_s;
  const std::optional<RotorSample> settled = rotor_source_->Add(sample);
  TellFaults();
  if (settled) Observe(*settled);
}

void EstimatorNode::TellFaults() {
  for (const RotorFault& fault : rotor_source_->TakeFaults()) {
    ROS_WARN("%s from %.3f s: %s%s", RotorName(fault.rotor).c_str(), ToSeconds(fault.stamp),
             fault.reason.c_str(), fault.failed ? "; speeds from its commands stand in" : "");
    if (fault.failed) {
      ++rotor_faults_;
      bad_sensors_[fault.rotor] = fault;
    } else {
      bad_sensors_.erase(fault.rotor);
    }
  }
}

RotorStatus EstimatorNode::RotorsNow() const {
  RotorStatus status;
  status.from_commands = rotor_source_->from_commands();
  const bool has_drive = has_voltage_ || !setup_.vehicle.actuator->uses_voltage;
  status.is_watching = !status.from_commands && has_commands_ && has_drive && !intake_.rms_only();
  for (const auto& [rotor, fault] : bad_sensors_) status.bad.push_back(fault);
  status.replaced = rotor_source_->replaced();
  status.faults = rotor_faults_;
  return status;
}

// What estimator and watch get to see.
void EstimatorNode::Observe(const Sample& recorded) {
  Sample sample = recorded;
  std::visit([this](auto& s) { mender_.Mend(&s); }, sample);
  const auto add_to = [&sample](auto* sink) {
    std::visit(
        [sink](const auto& s) {
          using Kind = std::decay_t<decltype(s)>;
          if constexpr (!std::is_same_v<Kind, CommandSample>) sink->Add(s);
        },
        sample);
  };
  // An IMU that came after the model was made: its mount is not known.
  if (std::holds_alternative<ImuSample>(sample) && ignores_imu_) return;
  std::visit(
      [this](const auto& s) {
        using Kind = std::decay_t<decltype(s)>;
        if constexpr (!std::is_same_v<Kind, BatterySample> && !std::is_same_v<Kind, CommandSample>)
          streams_seen_->Add(s);
      },
      recorded);
  add_to(estimator_.get());
  if (watch_) add_to(watch_.get());
  HandOverStreams();
  AdoptInspection();
  StepWhileThereIsMore();
}

// The newest minute of the streams, to be compared with each other by the watching thread.
void EstimatorNode::HandOverStreams() {
  if (!streams_seen_->IsDue()) return;
  FlightLog log = streams_seen_->TakeLook();
  log.rotor_rms_only = intake_.rms_only();
  const std::lock_guard<std::mutex> lock(watch_mutex_);
  to_be_inspected_ = StreamsSeen{std::move(log), setup_.vehicle, model_};
}

// What the watching thread found. Streams that are mended otherwise from now on are others.
void EstimatorNode::AdoptInspection() {
  std::optional<StreamsFound> found;
  {
    const std::unique_lock<std::mutex> lock(watch_mutex_, std::try_to_lock);
    if (!lock.owns_lock()) return;
    found.swap(inspected_);
  }
  if (!found) return;
  const bool is_new = mender_.Adopt(found->inspection);
  doubted_ = found->model;
  doubts_ = std::move(found->changes);
  for (const Finding& finding : mender_.findings()) {
    if (told_.insert(finding.check).second) ROS_WARN("%s", Sentence(finding).c_str());
  }
  if (is_new && !frozen_) {
    estimator_->StartAnew();
    ForgetEstimate("the streams are mended from now on");
  }
  RenewFindings();
}

void EstimatorNode::StepWhileThereIsMore() {
  while (true) {
    const Snapshot* const snapshot = estimator_->Step();
    if (!estimator_->made_progress()) return;
    if (estimator_->counters().starts_anew != starts_anew_) {
      ForgetEstimate("the vehicle had stood on the ground");
    }
    PublishPhase();
    if (watch_) watch_->SetAirborne(estimator_->last_keyframe_stamp(), estimator_->airborne());
    if (snapshot) {
      OnSnapshot(*snapshot);
    } else if (last_) {
      // What was learned in the air still stands, on the ground and while frozen.
      last_->airborne = estimator_->airborne();
      if (last_->airborne) {
        last_->stamp = estimator_->last_keyframe_stamp();
        last_is_published_ = false;
      }
      PublishParameters(*last_);
      PublishDisplays(*last_);
    }
    ShareStatus();
  }
}

// What was learned so far came from no flight, or from other streams.
void EstimatorNode::ForgetEstimate(const char* why) {
  starts_anew_ = estimator_->counters().starts_anew;
  if (last_) ROS_WARN("%s: what was learned before is forgotten", why);
  last_.reset();
  if (history_watch_) history_watch_->Reset();
  look_back_.clear();
  RenewFindings();
  last_look_s_ = 0.0;
  acceptance_.Reset();
}

// Every ten seconds of flight: do its thirds agree?
void EstimatorNode::LookBack() {
  constexpr double kLookEvery_s = 10.0;
  const EstimatorCounters& counters = estimator_->counters();
  if (counters.airborne_s < last_look_s_ + kLookEvery_s) return;
  last_look_s_ = counters.airborne_s;
  const std::vector<ThirdsDifference> thirds = estimator_->LastLook();
  look_back_ = last_ ? LastLookFindings(*model_, last_->values, thirds) : std::vector<Finding>();
  if (counters.changes > 0 && !setup_.estimator.detect_changes) {
    look_back_.push_back(VehicleChanged(counters.last_change, estimator_->start()));
  }
  RenewFindings();
}

void EstimatorNode::RenewFindings() {
  findings_ = mender_.findings();
  findings_.insert(findings_.end(), look_back_.begin(), look_back_.end());
}

void EstimatorNode::PublishPhase() {
  const std::string phase = Name(estimator_->phases().phase());
  if (phase == phase_ || !ros::ok()) return;
  phase_ = phase;
  std_msgs::String message;
  message.data = phase;
  phase_publisher_.publish(message);
}

// What may be wrong with the streams, and was not taken off, belongs to the estimate's sigma.
void EstimatorNode::WidenForDoubts(Snapshot* snapshot) const {
  if (doubted_ != model_) return;
  for (const Eigen::VectorXd& change : doubts_) {
    for (Eigen::Index i = 0; i < change.size(); ++i) {
      if (snapshot->sigma[i] > 0.0) snapshot->sigma[i] = std::hypot(snapshot->sigma[i], change[i]);
    }
    if (snapshot->covariance.rows() == change.size()) {
      snapshot->covariance += change * change.transpose();
    }
  }
}

void EstimatorNode::OnSnapshot(Snapshot snapshot) {
  if (!IsFinite(snapshot)) {
    ++not_finite_;
    ROS_ERROR_THROTTLE(1.0, "the estimate is not finite and is not published");
    return;
  }
  const Clock::time_point start = Clock::now();
  Keep(snapshot.timing.wall_ms, &update_ms_);
  LookBack();
  WidenForDoubts(&snapshot);
  acceptance_.Update(*model_, snapshot, findings_);
  if (history_watch_) {
    unlike_history_ =
        history_watch_->Look(snapshot.time_s, *model_, snapshot.values, snapshot.sigma);
  }
  if (watch_) watch_->SetEstimate(model_, snapshot.values, estimator_->start());
  {
    const std::lock_guard<std::mutex> lock(status_mutex_);
    if (status_.model != model_) {
      // What is drawn belongs to one model.
      status_.model = model_;
      status_.observable = snapshot.observable;
      history_.Clear();
    }
    history_.Add(snapshot);
  }
  last_model_ = model_;
  last_ = std::move(snapshot);
  last_is_published_ = false;
  if (ros::ok()) PublishEstimate(*last_);
  Keep(std::chrono::duration<double, std::milli>(Clock::now() - start).count(), &publish_ms_);
}

void EstimatorNode::AddWhatWasFound() {
  std::optional<ResidualLook> found;
  {
    const std::lock_guard<std::mutex> lock(watch_mutex_);
    found.swap(to_be_added_);
  }
  if (!found || found->model != model_ || last_model_ != model_ || frozen_) return;
  const std::string& name = found->candidate->name;
  try {
    const Vehicle extended = With(setup_.vehicle, *found->candidate);
    const Vehicle warm =
        WarmStarted(extended, Estimator::ToParameterSet(*last_model_, *last_), *found);
    auto model = std::make_shared<DynamicModel>(warm, warm.effects);
    auto estimator =
        std::make_unique<Estimator>(model.get(), setup_.estimator, !intake_.rms_only());
    estimator->CarryOn(*estimator_, DynamicModel(extended, extended.effects));
    estimator_ = std::move(estimator);
    model_ = std::move(model);
    HoldOut();
    setup_.vehicle.effects = extended.effects;
    setup_.vehicle.parameters = extended.parameters;
  } catch (const std::exception& e) {
    ROS_ERROR("%s was found, but cannot be added: %s", name.c_str(), e.what());
    return;
  }
  acceptance_.Reset();
  added_effects_ += (added_effects_.empty() ? "" : ", ") + name;
  ROS_WARN("added %s to the model in flight (add_effects): %.3g nats, found %d times in a row",
           name.c_str(), found->candidate->score, found->in_a_row);
  const std::lock_guard<std::mutex> lock(status_mutex_);
  status_.added_effects.push_back(name);
}

void EstimatorNode::PublishEstimate(const Snapshot& snapshot) {
  const std::string& body_frame = setup_.options.body_frame;
  state_publisher_.publish(BodyOdometry(snapshot, intake_.frame_id(), body_frame));
  wrench_publisher_.publish(ResidualWrench(snapshot, body_frame));
  path_.Add(snapshot);
  PublishParameters(snapshot);
  PublishBodyTransform(snapshot);
  PublishDisplays(snapshot);
}

void EstimatorNode::PublishParameters(const Snapshot& snapshot) {
  const Clock::time_point time = Clock::now();
  const std::chrono::duration<double> period(1.0 / setup_.options.publish_rate_hz);
  const bool is_news = !last_is_published_ || !snapshot.airborne;
  if (!ros::ok() || !is_news || time - parameters_published_ < period) return;
  parameters_published_ = time;
  last_is_published_ = true;
  DynamicParameters message = odmc::ToMessage(*last_model_, snapshot, setup_.options.body_frame);
  message.accepted = acceptance_.accepted();
  message.trust = Name(TrustOf(findings_));
  message.trust_reasons = TrustReasons(findings_);
  message.phase = phase_;
  parameters_publisher_.publish(message);
  PublishPlots(snapshot);
  PublishTransforms(snapshot);
  if (message.accepted && snapshot.airborne && interrupted_.empty() &&
      time - accepted_published_ >= kAcceptedPeriod) {
    accepted_published_ = time;
    PublishAccepted(snapshot);
  }
}

// What of the estimate is fit for use, as of `snapshot`.
void EstimatorNode::PublishAccepted(const Snapshot& snapshot) {
  Snapshot usable = acceptance_.Usable();
  usable.stamp = snapshot.stamp;
  usable.airborne = snapshot.airborne;
  if (!IsFinite(usable)) return;
  DynamicParameters message = odmc::ToMessage(*last_model_, usable, setup_.options.body_frame);
  message.accepted = true;
  accepted_publisher_.publish(message);
}

void EstimatorNode::PublishTransforms(const Snapshot& snapshot) {
  const std::string& body_frame = setup_.options.body_frame;
  std::vector<geometry_msgs::TransformStamped> transforms;
  if (IsEstimated(*last_model_, "odometry_extrinsics")) {
    const std::string& frame = SensorFrame();
    transforms.push_back(ToTransform(snapshot.stamp, body_frame,
                                     (frame.empty() ? "odometry" : frame) + kCalibrated,
                                     snapshot.body.p_BS, snapshot.body.R_BS));
  }
  if (IsEstimated(*last_model_, "imu_extrinsics")) {
    const std::string frame = intake_.imu_frame_id().value_or("");
    transforms.push_back(ToTransform(snapshot.stamp, body_frame,
                                     (frame.empty() ? "imu" : frame) + kCalibrated,
                                     snapshot.body.p_BI, snapshot.body.R_BI));
  }
  if (!transforms.empty()) tf_broadcaster_.sendTransform(transforms);
}

/// RViz refuses a frame without a name, as some odometry has it.
std::string EstimatorNode::WorldFrame() const {
  return intake_.frame_id().empty() ? "world" : intake_.frame_id();
}

/// Of the odometry's sensor; empty where nobody says.
const std::string& EstimatorNode::SensorFrame() const {
  const EstimatorNodeOptions& options = setup_.options;
  return options.uses_tf() ? options.odometry_tf_child : intake_.sensor_frame_id();
}

void EstimatorNode::PublishDisplays(const Snapshot& snapshot) {
  const Clock::time_point time = Clock::now();
  const std::chrono::duration<double> period(1.0 / setup_.options.display_rate_hz);
  if (!ros::ok() || time - displayed_ < period) return;
  displayed_ = time;
  if (displays_publisher_.getNumSubscribers() > 0) {
    const std::string verdict = !snapshot.airborne         ? ""
                                : acceptance_.accepted() ? "accepted"
                                                         : "not accepted";
    displays_publisher_.publish(DisplayMarkers(
        *last_model_, snapshot, {WorldFrame(), setup_.options.body_frame, phase_, verdict}));
  }
  if (path_publisher_.getNumSubscribers() > 0) path_publisher_.publish(path_.Message(WorldFrame()));
}

// Two publishers of one transform would have the vehicle leap to and fro: where it is left to the
// node, it waits whether somebody else does it.
void EstimatorNode::PublishBodyTransform(const Snapshot& snapshot) {
  const std::string& body_tf = setup_.options.body_tf;
  const std::string& body_frame = setup_.options.body_frame;
  if (body_tf == "never") return;
  if (body_tf == "auto") {
    if (!has_body_tf_ && Clock::now() - started_ > kTfPatience) {
      has_body_tf_ = tf_buffer_.canTransform(WorldFrame(), body_frame, ros::Time(0));
    }
    if (has_body_tf_.value_or(true)) return;
  }
  const nav_msgs::Odometry state = BodyOdometry(snapshot, WorldFrame(), body_frame);
  tf_broadcaster_.sendTransform(ToTransform(
      snapshot.stamp, WorldFrame(), body_frame, ToEigen(state.pose.pose.position),
      ToEigen(state.pose.pose.orientation).toRotationMatrix()));
}

void EstimatorNode::PublishPlots(const Snapshot& snapshot) {
  const sensor_msgs::JointState plot =
      PlottedEstimates(*last_model_, snapshot, setup_.options.body_frame);
  plot_publisher_.publish(plot);
  if (!setup_.options.plot_topics) return;
  for (size_t i = 0; i < plot.name.size(); ++i) {
    auto& [value, sigma] = plot_publishers_[plot.name[i]];
    if (!value) {
      const std::string topic = "plot/" + PlotTopic(plot.name[i]);
      value = private_node_.advertise<std_msgs::Float64>(topic + "/value", 10);
      sigma = private_node_.advertise<std_msgs::Float64>(topic + "/sigma", 10);
    }
    std_msgs::Float64 number;
    number.data = plot.position[i];
    value.publish(number);
    number.data = plot.velocity[i];
    sigma.publish(number);
  }
}

void EstimatorNode::Warn(const std::string& sentence) {
  ROS_WARN("%s", sentence.c_str());
  const std::lock_guard<std::mutex> lock(status_mutex_);
  status_.warnings.push_back(sentence);
}

// Why the flight has not taught anything for the last while: no keyframes, or none that hang
// together. Empty on the ground, and if it has.
std::string EstimatorNode::Interruption() {
  const Clock::time_point now = Clock::now();
  if (now - progress_looked_at_ < kProgressPeriod) return interrupted_;
  const EstimatorCounters before = std::exchange(progress_, estimator_->counters());
  const bool is_first = progress_looked_at_ == Clock::time_point();
  const auto seen = [](const EstimatorCounters& c) { return c.keyframes + c.ground_keyframes; };
  comes_on_ = !is_first && seen(progress_) > seen(before);
  progress_looked_at_ = now;
  if (is_first || !last_ || !estimator_->airborne() || frozen_) return "";
  const long keyframes = progress_.keyframes - before.keyframes;
  const long gaps = progress_.gaps - before.gaps;
  if (keyframes < 0) return "";                                               // a new estimator
  if (keyframes == 0 && progress_.airborne_s > before.airborne_s) return "";  // near the ground
  const std::string missing = MissingStream();
  if (keyframes == 0) {
    return "nothing is learned any more: no " + (missing.empty() ? "odometry" : missing);
  }
  if (2 * gaps < keyframes) return "";
  return "nothing is learned: gaps between most keyframes" +
         (missing.empty() ? " (odometry too slow, or stamps of the streams that do not agree)"
                          : ", " + missing + " missing or late");
}

/// The stream the estimator waits for, by the name of its topic.
std::string EstimatorNode::MissingStream() const {
  const std::string& stream = estimator_->waiting_for();
  const bool from_commands = rotor_source_ && rotor_source_->from_commands();
  return from_commands && stream == NameOf(InputStream::kRotorSpeeds)
             ? NameOf(InputStream::kMotorCommands)
             : stream;
}

void EstimatorNode::ShareStatus() {
  const Clock::time_point now = Clock::now();
  if (now - status_shared_ < kStatusPeriod) return;
  status_shared_ = now;
  if (estimator_) {
    const std::string interruption = Interruption();
    if (interruption != interrupted_ && !interruption.empty()) {
      ROS_WARN("%s", interruption.c_str());
    } else if (interruption.empty() && !interrupted_.empty()) {
      ROS_INFO("learning goes on");
    }
    interrupted_ = interruption;
  }
  const std::lock_guard<std::mutex> lock(status_mutex_);
  NodeStatus& s = status_;
  s.clock_resets = intake_.resets();
  s.stale = intake_.stale();
  s.forgotten = intake_.forgotten();
  s.not_finite = not_finite_;
  if (rotor_source_) s.rotors = RotorsNow();
  s.waiting_for = intake_.WaitingFor();
  if (tf_odometry_ && s.waiting_for == "odometry or pose") {
    s.waiting_for = "tf from " + setup_.options.odometry_tf_parent + " to " +
                    setup_.options.odometry_tf_child;
  }
  if (intake_.phase() == IntakePhase::kRefused) {
    s.fatal = "the twist of the odometry fits neither frame: " + intake_.twist().Describe() +
              "; state twist_frame if the position is at fault";
    ROS_ERROR_ONCE("%s", s.fatal.c_str());
  }
  if (intake_.twist().moving_s > 0.0) s.twist = TwistText();
  if (!estimator_) return;
  if (!s.model) s.model = model_;
  s.waiting_for = MissingStream();
  // Between two poses it always waits for the next one.
  if (comes_on_ && s.waiting_for == NameOf(InputStream::kOdometry)) s.waiting_for.clear();
  s.interrupted = interrupted_;
  if (!last_ && !s.waiting_for.empty() && now - started_ > kLongWait) {
    ROS_WARN_THROTTLE(30.0, "still waiting for %s: see /diagnostics for what comes in",
                      s.waiting_for.c_str());
  }
  s.airborne = estimator_->airborne();
  s.phase = phase_;
  s.trust = Name(TrustOf(findings_));
  s.findings.clear();
  for (const Finding& finding : findings_) {
    s.findings += (s.findings.empty() ? "" : " | ") + Sentence(finding);
  }
  s.rotor_speeds_late_s = mender_.OffsetOf("rotor_speeds");
  s.imu_late_s = mender_.OffsetOf("gyro");
  s.counters = estimator_->counters();
  s.stream_counters = estimator_->stream_counters();
  s.noise = estimator_->odometry_noise();
  s.accepted = acceptance_.accepted();
  s.not_accepted_because = acceptance_.reasons();
  s.held_back = acceptance_.held_back();
  s.has_estimate = last_.has_value();
  if (last_) ShareSnapshot(*last_, &s);
}

/// What earlier flights did not let expect.
std::vector<std::string> EstimatorNode::UnlikeHistorySentences() const {
  std::vector<std::string> sentences;
  for (const UnlikeHistory& unlike : unlike_history_) {
    const int k = last_model_->IndexOf(unlike.full_name);
    if (k >= 0) sentences.push_back(unlike.Sentence(last_model_->parameters()[k].spec.unit));
  }
  return sentences;
}

void EstimatorNode::ShareSnapshot(const Snapshot& snapshot, NodeStatus* s) const {
  s->unphysical = UnphysicalValues(*last_model_, snapshot.values, snapshot.sigma);
  const std::string doubt = ThrustDoubt(*last_model_, snapshot.values);
  if (!doubt.empty()) s->unphysical.push_back(doubt);
  s->unlike_history = UnlikeHistorySentences();
  s->unobservable = snapshot.unobservable;
  s->observable = snapshot.observable;
  s->time_s = snapshot.time_s;
  s->states_in_window = snapshot.timing.states;
  s->residual_force_rms_N = snapshot.residual_force_rms_N;
  s->residual_torque_rms_Nm = snapshot.residual_torque_rms_Nm;
  s->battery_voltage_V = snapshot.battery_voltage_V;
  s->update_ms_median = Percentile(update_ms_, 0.5);
  s->update_ms_p99 = Percentile(update_ms_, 0.99);
  s->publish_ms_median = Percentile(publish_ms_, 0.5);
  s->publish_ms_p99 = Percentile(publish_ms_, 0.99);
}

std::string EstimatorNode::TwistText() const {
  const std::string verdict = intake_.frame() == TwistFrame::kWorld     ? "world: "
                              : intake_.frame() == TwistFrame::kBody    ? "body: "
                              : intake_.frame() == TwistFrame::kNeither ? "neither: "
                                                                        : "undecided: ";
  return verdict + intake_.twist().Describe();
}

void EstimatorNode::Finish() {
  const Clock::time_point give_up = Clock::now() + kFinishPatience;
  std::deque<InputSample> batch;
  while (TakeBatch(&batch) && Clock::now() < give_up) Process(&batch);
  if (estimator_ && batch.empty() && !stopped_by_clock_) {
    estimator_->Finish();
    StepWhileThereIsMore();
  }
  if (setup_.options.output_dir.empty()) return;
  if (last_) {
    Tell("wrote " + Save());
  } else {
    Tell("nothing was estimated, no parameters.yaml is written");
  }
}

// The log is gone by the time a node has been told to stop.
void EstimatorNode::Tell(const std::string& sentence) const {
  if (ros::ok()) {
    ROS_WARN("%s", sentence.c_str());
  } else {
    std::fprintf(stderr, "%s: %s\n", ros::this_node::getName().c_str(), sentence.c_str());
  }
}

std::string EstimatorNode::Save() const {
  ParameterSet set = Estimator::ToParameterSet(*last_model_, *last_);
  set.provenance["tool"] = "estimator_node";
  set.provenance["version"] = ODMC_VERSION;
  set.provenance["date"] = Now();
  set.provenance["vehicle"] = setup_.vehicle.name;
  set.provenance["vehicle_file"] =
      setup_.options.vehicle_file.empty() ? "robot_description" : setup_.options.vehicle_file;
  set.provenance["airborne_s"] = std::to_string(estimator_->counters().airborne_s);
  set.provenance["keyframes"] = std::to_string(estimator_->counters().keyframes);
  set.provenance["newest_stamp_ns"] = std::to_string(last_->stamp);
  if (!added_effects_.empty()) set.provenance["added_in_flight"] = added_effects_;
  set.provenance["accepted"] = acceptance_.accepted() ? "true" : "false";
  AddTrust(findings_, &set);
  const std::filesystem::path folder(setup_.options.output_dir);
  std::string file = (folder / "parameters.yaml").string();
  // A result that was fit for use is not given up for one that is not.
  if (!acceptance_.accepted() && IsAcceptedFile(file)) {
    file = (folder / "parameters_not_accepted.yaml").string();
  }
  SaveParameters(set, file);
  if (ros::ok()) ROS_INFO("wrote %s", file.c_str());
  return file;
}

// ---- Watching thread ---------------------------------------------------------------------------

void EstimatorNode::RunWatching() {
  // A look takes a second or so and can wait; the estimator can't.
  setpriority(PRIO_PROCESS, static_cast<id_t>(syscall(SYS_gettid)), kWatchNiceness);
  const auto is_stopping = [this] {
    const std::lock_guard<std::mutex> lock(queue_mutex_);
    return stopping_;
  };
  while (true) {
    {
      std::unique_lock<std::mutex> lock(queue_mutex_);
      if (reporting_wakes_.wait_for(lock, kWatchIdle, [this] { return stopping_; })) return;
    }
    InspectStreamsIfDue();
    std::shared_ptr<ResidualWatch> watch;
    {
      const std::lock_guard<std::mutex> lock(watch_mutex_);
      watch = watch_;
    }
    if (!watch) continue;
    try {
      const std::optional<ResidualLook> look = watch->Look(is_stopping);
      if (look) OnLook(*look);
    } catch (const std::exception& e) {
      ROS_ERROR_THROTTLE(10.0, "the residual cannot be looked at: %s", e.what());
    }
  }
}

void EstimatorNode::InspectStreamsIfDue() {
  std::optional<StreamsSeen> seen;
  {
    const std::lock_guard<std::mutex> lock(watch_mutex_);
    seen.swap(to_be_inspected_);
  }
  if (!seen) return;
  try {
    StreamsFound found;
    found.inspection = InspectRecording(seen->vehicle, &seen->log);
    found.model = seen->model;
    const Stamp from = seen->log.odometry.empty()
                           ? 0
                           : seen->log.odometry.back().stamp - FromSeconds(kDoubted_s);
    EstimatorOptions options = setup_.estimator;
    options.num_threads = 1;
    found.changes =
        ChangesWithout(found.inspection.doubts, seen->log, from, *seen->model, options);
    const std::lock_guard<std::mutex> lock(watch_mutex_);
    inspected_ = std::move(found);
  } catch (const std::exception& e) {
    ROS_ERROR_THROTTLE(10.0, "the streams cannot be compared: %s", e.what());
  }
}

void EstimatorNode::OnLook(const ResidualLook& look) {
  const EstimatorNodeOptions& options = setup_.options;
  std::vector<std::string> added;
  {
    const std::lock_guard<std::mutex> lock(status_mutex_);
    status_.unexplained = look;
    added = status_.added_effects;
  }
  if (ros::ok()) unexplained_publisher_.publish(odmc::ToMessage(look, options.body_frame, added));
  const int needed = options.residual_watch.residual_watch_confirmations;
  if (look.in_a_row < needed) return;
  const std::string& name = look.candidate->name;
  const auto& may = options.add_effects;
  const bool add = std::find(may.begin(), may.end(), name) != may.end();
  if (look.in_a_row == needed) {
    ROS_INFO("%.0f %% of the residual in %s is structure; %s would explain it (%.3g nats)%s",
             100.0 * look.structured_share, look.channel.c_str(), name.c_str(),
             look.candidate->score, add ? "" : "; it is not in add_effects");
  }
  if (!add) return;
  const std::lock_guard<std::mutex> lock(watch_mutex_);
  to_be_added_ = look;
}

// ---- Reporting thread --------------------------------------------------------------------------

void EstimatorNode::RunReporting() {
  Clock::time_point last_report = Clock::now();
  std::array<StreamStatus, kNumInputStreams> before = {};
  for (bool odd = false;; odd = !odd) {
    std::array<StreamStatus, kNumInputStreams> streams;
    size_t queued = 0;
    {
      std::unique_lock<std::mutex> lock(queue_mutex_);
      const auto due = Clock::now() + kReportPeriod;
      if (reporting_wakes_.wait_until(lock, due, [this] { return stopping_; })) return;
      streams = streams_;
      queued = queue_.size();
    }
    PublishLiveImage();
    if (!odd) continue;
    const Clock::time_point now = Clock::now();
    PublishDiagnostics(streams, before, queued,
                       std::chrono::duration<double>(now - last_report).count());
    before = streams;
    last_report = now;
  }
}

NodeStatus EstimatorNode::Status() {
  const std::lock_guard<std::mutex> lock(status_mutex_);
  return status_;
}

void EstimatorNode::PublishDiagnostics(const std::array<StreamStatus, kNumInputStreams>& streams,
                                       const std::array<StreamStatus, kNumInputStreams>& before,
                                       size_t queued, double seconds) {
  if (!ros::ok()) return;
  NodeStatus status = Status();
  status.queued = queued;
  diagnostic_msgs::DiagnosticArray message;
  message.header.stamp = ros::Time::now();
  const std::string name = ros::this_node::getName();
  message.status.push_back(EstimatorDiagnostic(status, name + ": estimator"));
  message.status.push_back(UnexplainedDiagnostic(status, name + ": unexplained"));
  if (status.rotors) message.status.push_back(RotorDiagnostic(*status.rotors, name + ": rotors"));
  message.status.push_back(InputDiagnostic(streams, before, seconds, name + ": inputs"));
  diagnostics_publisher_.publish(message);
}

void EstimatorNode::PublishLiveImage() {
  if (!ros::ok()) return;
  if (!setup_.options.live_image && image_publisher_.getNumSubscribers() == 0) return;
  NodeStatus status;
  LiveHistory history;
  {
    const std::lock_guard<std::mutex> lock(status_mutex_);
    status = status_;
    history = history_;
  }
  if (status.model == nullptr) return;
  LiveImageTexts texts;
  texts.title = setup_.vehicle.name;
  texts.good = status.accepted;
  texts.status = !status.fatal.empty() ? "stopped"
                 : !status.airborne    ? "on the ground"
                 : status.accepted     ? "airborne, accepted"
                                       : "airborne";
  char details[160];
  std::snprintf(details, sizeof details,
                "%.1f s   residual %.3g N, %.2g N m   update %.1f ms (p99 %.1f)", status.time_s,
                status.residual_force_rms_N, status.residual_torque_rms_Nm, status.update_ms_median,
                status.update_ms_p99);
  texts.details = details;
  texts.warnings = status.unphysical;
  if (status.rotors) {
    const std::vector<std::string> bad = status.rotors->Sentences();
    texts.warnings.insert(texts.warnings.end(), bad.begin(), bad.end());
  }
  texts.warnings.insert(texts.warnings.end(), status.warnings.begin(), status.warnings.end());
  image_publisher_.publish(
      ToMessage(DrawLiveImage(*status.model, history, status.observable, texts)));
}

}  // namespace odmc
