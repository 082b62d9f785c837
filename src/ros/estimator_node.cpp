#include "odmc/ros/estimator_node.h"

#include <ros/console.h>
#include <ros/init.h>
#include <ros/this_node.h>
#include <std_srvs/SetBool.h>
#include <std_srvs/Trigger.h>

#include <algorithm>
#include <cstdio>
#include <ctime>
#include <filesystem>
#include <stdexcept>
#include <utility>

#include "odmc/io/parameters_yaml.h"
#include "odmc/ros/conversions.h"
#include "odmc/ros/diagnostic_values.h"
#include "odmc/ros/estimate_messages.h"

namespace odmc {
namespace {

constexpr std::chrono::milliseconds kStatusPeriod(100);
constexpr std::chrono::seconds kLongWait(5);
constexpr std::chrono::seconds kFinishPatience(2);
constexpr size_t kTimedUpdates = 1000;  // the percentiles look back this far

/// Date and time in ISO 8601, UTC.
std::string Now() {
  const std::time_t now = std::time(nullptr);
  std::tm parts{};
  gmtime_r(&now, &parts);
  char text[32];
  std::strftime(text, sizeof text, "%Y-%m-%dT%H:%M:%SZ", &parts);
  return text;
}

/// No more than kTimedUpdates.
void KeepNewest(double ms, std::deque<double>* all) {
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

/// The actuator whose dynamics are known; null: none.
const Actuator* KnownActuator(const Vehicle& vehicle) {
  return vehicle.actuator && vehicle.actuator->knows_dynamics ? &*vehicle.actuator : nullptr;
}

bool Contains(const std::vector<std::string>& names, const std::string& name) {
  return std::find(names.begin(), names.end(), name) != names.end();
}

/// Adds a sample to an estimator or a watch; commands are for neither.
template <typename Sink>
void AddTo(Sink* sink, const Sample& sample) {
  std::visit(
      [sink](const auto& s) {
        using Kind = std::decay_t<decltype(s)>;
        if constexpr (!std::is_same_v<Kind, CommandSample>) sink->Add(s);
      },
      sample);
}

}  // namespace

EstimatorNode::EstimatorNode(const ros::NodeHandle& node, const ros::NodeHandle& private_node,
                             EstimatorNodeSetup setup)
    : setup_(std::move(setup)),
      unexplained_publisher_(
          ros::NodeHandle(node).advertise<UnexplainedResidual>("unexplained", 10)),
      queue_(setup_.options.queue_size),
      mounts_(setup_.options.body_frame),
      intake_(setup_.options.twist_frame, RotorIntakeOf(setup_)),
      rotors_(KnownActuator(setup_.vehicle), setup_.vehicle.num_rotors(),
              RotorIntakeOf(setup_).from_commands),
      session_(&setup_),
      publisher_(node, private_node, &setup_.options, &mounts_.buffer()) {
  shared_.With([this](SharedStatus* s) {
    if (rotors_.is_on()) s->status.rotors = rotors_.Now(false);
    s->status.waiting_for = intake_.WaitingFor();
    s->status.watches_residual = setup_.options.residual_watch.residual_watch_period_s > 0.0;
  });
  for (const std::string& sentence : setup_.warnings) Warn(sentence);
  looks_ = std::make_unique<BackgroundAnalysis>(
      setup_.estimator, [this](const ResidualAnalysis& look) { OnLook(look); }, &queue_);
  reporter_ = std::make_unique<NodeReporter>(node, setup_.vehicle.name, setup_.options.live_image,
                                             &shared_, &queue_);
  const bool supervises_rotors = rotors_.is_on();
  estimator_thread_ = std::thread(&EstimatorNode::RunEstimator, this);
  try {
    topics_ = std::make_unique<TopicIntake>(
        node, setup_.options, setup_.vehicle.num_rotors(), supervises_rotors, &queue_,
        [this](const std::string& sentence) { Warn(sentence); });
    AdvertiseServices(private_node);
  } catch (...) {
    Stop();  // the threads wait for it
    throw;
  }
}

EstimatorNode::~EstimatorNode() { Stop(); }

bool EstimatorNode::Stop() {
  if (!estimator_thread_.joinable()) return failure_.empty();
  if (topics_) topics_->Stop();
  queue_.Stop();
  estimator_thread_.join();
  reporter_->Join();
  looks_->Join();
  return failure_.empty();
}

// ---- Any thread --------------------------------------------------------------------------------

void EstimatorNode::AdvertiseServices(ros::NodeHandle private_node) {
  using std_srvs::SetBool;
  using std_srvs::Trigger;
  const auto trigger = [&](const std::string& name, Answer (EstimatorNode::*act)()) {
    const boost::function<bool(Trigger::Request&, Trigger::Response&)> callback =
        [this, act](Trigger::Request&, Trigger::Response& response) {
          const Answer answer = queue_.Ask([this, act] { return (this->*act)(); });
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
        const Answer answer = queue_.Ask([this, on] { return Freeze(on); });
        response.success = answer.first;
        response.message = answer.second;
        return true;
      };
  services_.push_back(private_node.advertiseService("freeze", freeze));
}

void EstimatorNode::Warn(const std::string& sentence) {
  ROS_WARN("%s", sentence.c_str());
  shared_.With([&](SharedStatus* s) { s->status.warnings.push_back(sentence); });
}

// The log is gone by the time a node has been told to stop.
void EstimatorNode::Tell(const std::string& sentence) const {
  if (ros::ok()) {
    ROS_WARN("%s", sentence.c_str());
  } else {
    std::fprintf(stderr, "%s: %s\n", ros::this_node::getName().c_str(), sentence.c_str());
  }
}

void EstimatorNode::OnLook(const ResidualAnalysis& look) {
  const EstimatorNodeOptions& options = setup_.options;
  const std::vector<std::string> added = shared_.With([&](SharedStatus* s) {
    s->status.unexplained = look;
    return s->status.added_effects;
  });
  if (ros::ok()) unexplained_publisher_.publish(odmc::ToMessage(look, options.body_frame, added));
  const int needed = options.residual_watch.residual_watch_confirmations;
  if (look.in_a_row < needed) return;
  const std::string& name = look.candidate->name;
  const bool may_be_added = Contains(options.add_effects, name);
  if (look.in_a_row == needed) {
    ROS_INFO("%.0f %% of the residual in %s is structure; %s would explain it (%.3g nats)%s",
             100.0 * look.structured_share, look.channel.c_str(), name.c_str(),
             look.candidate->score, may_be_added ? "" : "; it is not in add_effects");
  }
  if (may_be_added) looks_->Propose(look);
}

// ---- Estimator thread: services ----------------------------------------------------------------

EstimatorNode::Answer EstimatorNode::Reset() {
  if (!session_.has_started()) return {false, "nothing is estimated yet"};
  session_.Reset(!intake_.rms_only());
  WatchResidual();
  timing_.update_ms.clear();
  timing_.publish_ms.clear();
  looks_->TakeProposal();
  shared_.With([this](SharedStatus* s) {
    s->status.model = session_.model();
    s->status.observable.clear();
    s->status.unphysical.clear();
    s->status.unlike_history.clear();
    s->status.unobservable.clear();
    s->status.added_effects.clear();
    s->status.unexplained.reset();
    s->history.Clear();
  });
  ROS_INFO("reset: the estimator starts anew");
  return {true, "the estimator starts anew"};
}

EstimatorNode::Answer EstimatorNode::Freeze(bool freeze) {
  session_.Freeze(freeze);
  shared_.With([&](SharedStatus* s) { s->status.frozen = freeze; });
  return {true, freeze ? "nothing more is learned" : "learning goes on"};
}

EstimatorNode::Answer EstimatorNode::Accept() {
  const std::string objection = session_.ObjectionToAccepting();
  if (!objection.empty()) return {false, objection};
  publisher_.PublishAccepted(*session_.last(), session_.Context());
  return {true, "the present estimate is published as accepted"};
}

EstimatorNode::Answer EstimatorNode::SaveNow() {
  if (setup_.options.output_dir.empty()) return {false, "output_dir is not set"};
  if (session_.last() == nullptr) return {false, "nothing is estimated yet"};
  return {true, Save()};
}

std::string EstimatorNode::Save() const {
  ParameterSet set = session_.ToSave();
  set.provenance["tool"] = "estimator_node";
  set.provenance["version"] = ODMC_VERSION;
  set.provenance["date"] = Now();
  set.provenance["vehicle_file"] =
      setup_.options.vehicle_file.empty() ? "robot_description" : setup_.options.vehicle_file;
  const std::filesystem::path folder(setup_.options.output_dir);
  std::string file = (folder / "parameters.yaml").string();
  // A result that was fit for use is not given up for one that is not.
  if (!session_.is_accepted() && IsAcceptedFile(file)) {
    file = (folder / "parameters_not_accepted.yaml").string();
  }
  SaveParameters(set, file);
  if (ros::ok()) ROS_INFO("wrote %s", file.c_str());
  return file;
}

// ---- Estimator thread: samples -----------------------------------------------------------------

void EstimatorNode::RunEstimator() {
  try {
    std::deque<InputSample> batch;
    while (queue_.WaitForInput(&batch)) {
      queue_.AnswerRequests();
      Process(&batch);
      AddWhatWasFound();
      // What the throttle held back is still news once nothing more comes.
      if (const Snapshot* const last = session_.last()) {
        publisher_.PublishParameters(*last, session_.Context());
      }
      ShareStatus();
    }
    Finish();
  } catch (const std::exception& e) {
    failure_ = std::string("the estimator stopped: ") + e.what();
    Tell(failure_);
    shared_.With([this](SharedStatus* s) { s->status.fatal = failure_; });
  }
}

void EstimatorNode::Process(std::deque<InputSample>* batch) {
  for (InputSample& input : *batch) {
    if (stopped_by_clock_) break;
    if (!intake_.Push(std::move(input))) OnClockStepBack();
    if (intake_.phase() == IntakePhase::kHolding && intake_.decided()) StartIfMountsAreKnown();
  }
  batch->clear();
  if (!session_.has_started() || stopped_by_clock_) return;
  const std::vector<Sample> samples = intake_.Take();
  rotors_.FindVoltage(samples);
  for (const Sample& sample : samples) {
    if (queue_.StoppedBefore(kFinishPatience)) break;
    Feed(sample);
  }
}

void EstimatorNode::OnClockStepBack() {
  const bool stop = setup_.options.on_time_reset == "stop";
  ROS_WARN("the clock stepped back: %s", stop ? "the estimate stops here (on_time_reset: stop)"
                                              : "starting a new chain, parameters are kept");
  if (stop) {
    stopped_by_clock_ = true;
    shared_.With([](SharedStatus* s) {
      s->status.fatal = "the clock stepped back and on_time_reset is stop";
    });
  } else if (session_.has_started()) {
    session_.RestartChain();
    rotors_.Restart();
    if (const auto watch = looks_->watch()) watch->Clear();
    if (streams_seen_) streams_seen_->Clear();
    publisher_.ClearPath();
    shared_.With([](SharedStatus* s) { s->history.Clear(); });  // its time axis would run backwards
  }
}

void EstimatorNode::StartIfMountsAreKnown() {
  const std::string odometry_frame = FramesNow().sensor;
  std::optional<std::string> odometry, imu;
  if (!setup_.odometry_mount_known && !odometry_frame.empty()) odometry = odometry_frame;
  if (!session_.vehicle().imu) imu = intake_.imu_frame_id();
  const auto warn = [this](const std::string& sentence) { Warn(sentence); };
  if (!mounts_.Complete(odometry, imu, warn, session_.mutable_vehicle())) return;
  ignores_imu_ = !session_.vehicle().imu && !intake_.imu_frame_id();
  Start();
}

void EstimatorNode::Start() {
  session_.Start(!intake_.rms_only());
  streams_seen_.emplace(session_.vehicle());
  WatchResidual();
  if (intake_.rms_only()) {
    Warn("rotor speeds are root mean squares: force is estimated, torque is not");
  }
  if (!intake_.uses_pose() && !intake_.has_velocity()) Warn("the odometry has no linear twist");
  if (!intake_.uses_pose() && !intake_.has_rates()) Warn("the odometry has no angular twist");
  intake_.Release();
  ROS_INFO("estimating %s from %s%s%s", setup_.vehicle.name.c_str(),
           intake_.uses_pose() ? "poses" : "odometry",
           intake_.frame() == TwistFrame::kWorld ? ", twist in the world frame" : "",
           rotors_.from_commands() ? ", rotor speeds from commands" : "");
}

void EstimatorNode::WatchResidual() {
  if (setup_.options.residual_watch.residual_watch_period_s <= 0.0) return;
  Vehicle filed = session_.vehicle();
  filed.parameters = setup_.file_parameters;
  looks_->Watch(
      std::make_shared<ResidualWatch>(filed, setup_.options.residual_watch, !intake_.rms_only()));
}

void EstimatorNode::Feed(const Sample& sample) {
  if (const auto* command = std::get_if<CommandSample>(&sample)) {
    if (const std::optional<RotorSample> modelled = rotors_.Add(*command)) Observe(*modelled);
  } else if (const auto* rotors = std::get_if<RotorSample>(&sample)) {
    const std::optional<RotorSample> settled = rotors_.Add(*rotors, intake_.rms_only());
    if (settled) Observe(*settled);
  } else {
    if (const auto* battery = std::get_if<BatterySample>(&sample)) rotors_.Add(*battery);
    Observe(sample);
  }
}

// What estimator and watch get to see.
void EstimatorNode::Observe(const Sample& recorded) {
  // An IMU that came after the model was made: its mount is not known.
  if (std::holds_alternative<ImuSample>(recorded) && ignores_imu_) return;
  Sample sample = recorded;
  session_.Mend(&sample);
  std::visit(
      [this](const auto& s) {
        using Kind = std::decay_t<decltype(s)>;
        if constexpr (!std::is_same_v<Kind, BatterySample> && !std::is_same_v<Kind, CommandSample>)
          streams_seen_->Add(s);
      },
      recorded);
  AddTo(&session_.estimator(), sample);
  if (const auto watch = looks_->watch()) AddTo(watch.get(), sample);
  InspectStreams();
  StepWhileThereIsMore();
}

// The newest minute of the streams goes to be compared, and what was found comes back.
void EstimatorNode::InspectStreams() {
  if (streams_seen_->IsDue()) {
    FlightLog log = streams_seen_->TakeLook();
    log.rotor_rms_only = intake_.rms_only();
    looks_->Inspect(session_.SeenIn(std::move(log)));
  }
  std::optional<BackgroundAnalysis::StreamsFound> found = looks_->TakeInspection();
  if (found) session_.Adopt(*std::move(found));
}

void EstimatorNode::StepWhileThereIsMore() {
  const Estimator& estimator = session_.estimator();
  while (true) {
    const Snapshot* const snapshot = session_.Step();
    if (!estimator.made_progress()) return;
    publisher_.PublishPhase(Name(estimator.phases().phase()));
    if (const auto watch = looks_->watch()) {
      watch->SetAirborne(estimator.last_keyframe_stamp(), estimator.airborne());
    }
    if (snapshot) {
      OnSnapshot(*snapshot);
    } else if (const Snapshot* const last = session_.last()) {
      // What was learned in the air still stands, on the ground and while frozen.
      session_.KeepLast();
      publisher_.PublishParameters(*last, session_.Context(), last->airborne);
      publisher_.PublishDisplays(*last, session_.Context());
    }
    ShareStatus();
  }
}

void EstimatorNode::OnSnapshot(const Snapshot& snapshot) {
  if (!IsFinite(snapshot)) {
    ++timing_.not_finite;
    ROS_ERROR_THROTTLE(1.0, "the estimate is not finite and is not published");
    return;
  }
  const Clock::time_point start = Clock::now();
  KeepNewest(snapshot.timing.wall_ms, &timing_.update_ms);
  session_.Take(snapshot);
  const Snapshot& last = *session_.last();
  if (const auto watch = looks_->watch()) {
    watch->SetEstimate(session_.model(), last.values, session_.estimator().start());
  }
  shared_.With([&](SharedStatus* s) {
    if (s->status.model != session_.model()) {
      // What is drawn belongs to one model.
      s->status.model = session_.model();
      s->status.observable = last.observable;
      s->history.Clear();
    }
    s->history.Add(last);
  });
  publisher_.SetFrames(FramesNow());
  publisher_.Publish(last, session_.Context());
  KeepNewest(std::chrono::duration<double, std::milli>(Clock::now() - start).count(),
             &timing_.publish_ms);
}

void EstimatorNode::AddWhatWasFound() {
  const std::optional<ResidualAnalysis> found = looks_->TakeProposal();
  if (!found || !session_.Extend(*found, !intake_.rms_only())) return;
  shared_.With([&](SharedStatus* s) { s->status.added_effects.push_back(found->candidate->name); });
}

void EstimatorNode::Finish() {
  std::deque<InputSample> batch;
  bool is_all = false;
  while (!is_all && !queue_.StoppedBefore(kFinishPatience)) {
    is_all = !queue_.TakeBatch(&batch);
    if (!is_all) Process(&batch);
  }
  if (!is_all) {
    Tell("the newest samples may be missing: no time to work off all that was queued");
  } else if (session_.has_started() && !stopped_by_clock_) {
    session_.estimator().Finish();
    StepWhileThereIsMore();
  }
  if (setup_.options.output_dir.empty()) return;
  if (session_.last() != nullptr) {
    Tell("wrote " + Save());
  } else {
    Tell("nothing was estimated, no parameters.yaml is written");
  }
}

// ---- Estimator thread: what others are told ----------------------------------------------------

EstimatePublisher::Frames EstimatorNode::FramesNow() const {
  const EstimatorNodeOptions& options = setup_.options;
  return {intake_.frame_id(),
          options.uses_tf() ? options.odometry_tf_child : intake_.sensor_frame_id(),
          intake_.imu_frame_id().value_or("")};
}

/// The stream the estimator waits for, by the name of its topic.
std::string EstimatorNode::MissingStream() const {
  const std::string& stream = session_.estimator().waiting_for();
  return rotors_.from_commands() && stream == NameOf(InputStream::kRotorSpeeds)
             ? NameOf(InputStream::kMotorCommands)
             : stream;
}

void EstimatorNode::ShareStatus() {
  const Clock::time_point now = Clock::now();
  if (now - timing_.status_shared < kStatusPeriod) return;
  timing_.status_shared = now;
  if (session_.has_started()) session_.LookAtProgress(MissingStream());
  shared_.With([&](SharedStatus* s) {
    ShareIntake(&s->status);
    if (session_.has_started()) ShareEstimator(&s->status);
  });
}

void EstimatorNode::ShareIntake(NodeStatus* s) const {
  s->clock_resets = intake_.resets();
  s->stale = intake_.stale();
  s->leaps = intake_.leaps();
  s->forgotten = intake_.forgotten();
  s->not_finite = timing_.not_finite;
  if (rotors_.is_on()) s->rotors = rotors_.Now(intake_.rms_only());
  s->waiting_for = intake_.WaitingFor();
  if (setup_.options.uses_tf() && s->waiting_for == "odometry or pose") {
    s->waiting_for =
        "tf from " + setup_.options.odometry_tf_parent + " to " + setup_.options.odometry_tf_child;
  }
  if (intake_.phase() == IntakePhase::kRefused) {
    s->fatal = "the twist of the odometry fits neither frame: " + intake_.twist().Describe() +
               "; state twist_frame if the position is at fault";
    ROS_ERROR_ONCE("%s", s->fatal.c_str());
  }
  if (!(intake_.twist().moving_s > 0.0)) return;
  const std::string verdict = intake_.frame() == TwistFrame::kWorld     ? "world: "
                              : intake_.frame() == TwistFrame::kBody    ? "body: "
                              : intake_.frame() == TwistFrame::kNeither ? "neither: "
                                                                        : "undecided: ";
  s->twist = verdict + intake_.twist().Describe();
}

void EstimatorNode::ShareEstimator(NodeStatus* s) const {
  session_.Fill(s);
  s->waiting_for = MissingStream();
  // Between two poses it always waits for the next one.
  if (session_.comes_on() && s->waiting_for == NameOf(InputStream::kOdometry)) {
    s->waiting_for.clear();
  }
  if (!s->has_estimate && !s->waiting_for.empty() && Clock::now() - timing_.started > kLongWait) {
    ROS_WARN_THROTTLE(30.0, "still waiting for %s: see /diagnostics for what comes in",
                      s->waiting_for.c_str());
  }
  s->phase = publisher_.phase();
  if (!s->has_estimate) return;
  s->update_ms_median = Percentile(timing_.update_ms, 0.5);
  s->update_ms_p99 = Percentile(timing_.update_ms, 0.99);
  s->publish_ms_median = Percentile(timing_.publish_ms, 0.5);
  s->publish_ms_p99 = Percentile(timing_.publish_ms, 0.99);
}

}  // namespace odmc
