#include "odmc/ros/controller_node.h"

#include <diagnostic_msgs/DiagnosticArray.h>
#include <ros/console.h>
#include <ros/this_node.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "odmc/io/parameters_yaml.h"
#include "odmc/io/vehicle_yaml.h"
#include "odmc/ros/control_messages.h"
#include "odmc/ros/node_options.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

constexpr double kSameClock_s = 0.1;  // stamps this near to now are taken for now
constexpr double kDue = 0.75;         // of the control period
constexpr double kLate = 3.0;         // control periods
constexpr double kImuPatience_s = 0.01;
constexpr double kStatusPeriod_s = 0.02;

Stamp Now() { return FromRos(ros::Time::now()); }

}  // namespace

// ---- Set-up ------------------------------------------------------------------------------------

bool ControllerNodeOptions::IsValid(std::string* error) const {
  if (vehicle_file.empty()) return Invalid(error, "vehicle_file must name a vehicle YAML");
  if (!(control_rate_hz >= 50.0 && control_rate_hz <= 2000.0)) {
    return Invalid(error, "control_rate_hz must be 50 to 2000");
  }
  if (!TwistFrameStated(twist_frame)) {
    return Invalid(error, "twist_frame must be body, world or auto, not '" + twist_frame + "'");
  }
  if (!(reference_timeout_s > 0.0)) return Invalid(error, "reference_timeout_s must be positive");
  if (body_frame.empty()) return Invalid(error, "body_frame must not be empty");
  return true;
}

ControllerNodeSetup ReadControllerNodeSetup(const ros::NodeHandle& private_node) {
  ControllerNodeSetup setup;
  ReadNodeOptions(private_node, &ControllerNodeOptions::config, &setup.options, &setup.config);
  std::string error;
  if (!setup.options.IsValid(&error) || !setup.config.IsValid(&error)) {
    throw std::invalid_argument(private_node.getNamespace() + ": " + error);
  }
  setup.vehicle = LoadVehicle(setup.options.vehicle_file);
  if (!setup.options.parameters_file.empty()) {
    setup.saved = LoadParameters(setup.options.parameters_file);
    const std::string objection = ObjectionTo(*setup.saved);
    if (!objection.empty()) {
      throw std::invalid_argument(setup.options.parameters_file + ": " + objection +
                                  "; fly with the vehicle file alone, or calibrate anew");
    }
  }
  return setup;
}

ControllerNode::ControllerNode(const ros::NodeHandle& node, const ros::NodeHandle& private_node,
                               ControllerNodeSetup setup)
    : setup_(std::move(setup)),
      handover_(setup_.config.handover, setup_.vehicle),
      controller_(setup_.config.controller, handover_.model()),
      references_(setup_.options.reference_timeout_s),
      node_(node) {
  twist_.emplace();
  report_.uses_estimate = setup_.options.use_estimate;
  report_.has_actuator = setup_.vehicle.actuator.has_value();
  Subscribe();
  Advertise(private_node);
  const ros::Duration period(1.0 / setup_.options.control_rate_hz);
  step_timer_ =
      node_.createTimer(period, [this](const ros::TimerEvent&) { StepIfDue(Now(), false); });
  report_timer_ = node_.createWallTimer(
      ros::WallDuration(1.0), [this](const ros::WallTimerEvent&) { PublishDiagnostics(); });
}

void ControllerNode::Subscribe() {
  const ros::TransportHints hints = ros::TransportHints().tcpNoDelay();
  subscribers_ = {
      node_.subscribe("odometry", 20, &ControllerNode::OnOdometry, this, hints),
      node_.subscribe("imu", 50, &ControllerNode::OnImu, this, hints),
      node_.subscribe("rotor_speeds", 50, &ControllerNode::OnRotors, this, hints),
      node_.subscribe("reference", 20, &ControllerNode::OnReference, this, hints),
      node_.subscribe("command_trajectory", 5, &ControllerNode::OnTrajectory, this, hints),
      node_.subscribe("parameters_accepted", 5, &ControllerNode::OnAccepted, this, hints)};
  if (!report_.has_actuator) return;
  subscribers_.push_back(
      node_.subscribe("battery_state", 5, &ControllerNode::OnBattery, this, hints));
}

void ControllerNode::Advertise(ros::NodeHandle private_node) {
  rotor_publisher_ = node_.advertise<RotorSpeeds>("command/rotor_speeds", 10);
  if (report_.has_actuator) motor_publisher_ = node_.advertise<MotorCommands>("motor_commands", 10);
  rate_publisher_ = node_.advertise<RateThrust>("command/rate_thrust", 10);
  status_publisher_ = node_.advertise<ControllerStatus>("controller_status", 50);
  diagnostics_publisher_ = node_.advertise<diagnostic_msgs::DiagnosticArray>("/diagnostics", 10);
  services_ = {
      private_node.advertiseService("reset_parameters", &ControllerNode::OnResetParameters, this),
      private_node.advertiseService("use_estimate", &ControllerNode::OnUseEstimate, this)};
}

// ---- Input -------------------------------------------------------------------------------------

/// False for a stamp ahead of the clock, as what is left of a time it has stepped back from.
bool ControllerNode::HasCome(Stamp stamp, ControlInput* input) {
  const Stamp now = Now();
  WatchClock(now);
  if (!IsStepBack(stamp, now)) return true;
  if (now > 0) ++input->refused;
  return false;
}

bool ControllerNode::Admit(Stamp stamp, TopicClock* clock, ControlInput* input) {
  if (!HasCome(stamp, input)) return false;
  const Stamp now = Now();
  const StampVerdict verdict = clock->See(stamp, now);
  if (verdict == StampVerdict::kRefused) {
    ++input->refused;
    ROS_WARN_THROTTLE(5.0, "a sample was refused: its stamp is %.1f s behind its topic's newest",
                      ToSeconds(clock->newest() - stamp));
    return false;
  }
  if (verdict == StampVerdict::kBack) {
    OnClockStepBack();
    clock->See(stamp, now);
  }
  return true;
}

void ControllerNode::WatchClock(Stamp now) {
  if (IsStepBack(newest_now_, now)) OnClockStepBack();
  newest_now_ = std::max(newest_now_, now);
}

void ControllerNode::OnClockStepBack() {
  ROS_WARN("the clock stepped back: state and estimate are forgotten");
  ++report_.clock_resets;
  controller_.Reset();
  references_.Reset();
  twist_.emplace();
  odometry_clock_ = imu_clock_ = rotor_clock_ = battery_clock_ = TopicClock();
  newest_now_ = 0;
  last_step_.reset();
  last_status_.reset();
  report_.twist_warning.clear();
  BackToNominal(Now());
}

void ControllerNode::OnOdometry(const nav_msgs::Odometry::ConstPtr& message) {
  ++report_.odometry.received;
  const std::optional<OdometryInput> input = ToInput(*message);
  if (!input || !input->linear) {
    ++report_.odometry.refused;
    ROS_WARN_THROTTLE(5.0, "an odometry was refused: no stamp, not finite, or without velocity");
    return;
  }
  if (!Admit(input->sample.stamp, &odometry_clock_, &report_.odometry)) return;
  OdometrySample sample = input->sample;
  sample.v_WS = TwistInWorld(FrameOf(*input), sample.q_WS, *input->linear);
  controller_.Add(sample);
}

TwistFrame ControllerNode::FrameOf(const OdometryInput& input) {
  const OdometrySample& sample = input.sample;
  twist_->AddSample(sample.stamp, sample.p_WS, sample.q_WS, *input.linear);
  const TwistFrame verdict = twist_->decision().frame;
  const std::string& setting = setup_.options.twist_frame;
  const TwistFrame stated = *TwistFrameStated(setting);
  const TwistFrame used = ResolveTwistFrame(stated != TwistFrame::kUndecided ? stated : verdict,
                                            input.frame_id, input.child_frame_id);
  if (twist_->decided() && verdict != used && report_.twist_warning.empty()) {
    report_.twist_warning = "the odometry's twist does not fit twist_frame " + setting + ": " +
                            twist_->decision().Describe();
    ROS_WARN("%s", report_.twist_warning.c_str());
  }
  return used;
}

void ControllerNode::OnImu(const sensor_msgs::Imu::ConstPtr& message) {
  ++report_.imu.received;
  const std::optional<ImuInput> input = ToInput(*message);
  if (!input) {
    ++report_.imu.refused;
    return;
  }
  const Stamp stamp = input->sample.stamp;
  const Stamp before = imu_clock_.newest();
  if (!Admit(stamp, &imu_clock_, &report_.imu) || stamp == before) return;
  MeasureImuRate(stamp - before);
  controller_.Add(input->sample);
  const Stamp now = Now();
  StepIfDue(std::abs(ToSeconds(now - stamp)) < kSameClock_s ? stamp : now, true);
}

void ControllerNode::MeasureImuRate(Stamp since_last) {
  constexpr double kShare = 0.05;  // of each new sample
  const double period_s = std::clamp(ToSeconds(since_last), 0.0, 1.0);
  imu_period_s_ += kShare * (period_s - imu_period_s_);
}

void ControllerNode::OnRotors(const RotorSpeeds::ConstPtr& message) {
  ++report_.rotors.received;
  const std::optional<RotorInput> input = ToInput(*message, setup_.vehicle.num_rotors());
  if (!input || input->rms_only) {
    ++report_.rotors.refused;
    return;
  }
  if (Admit(input->sample.stamp, &rotor_clock_, &report_.rotors)) controller_.Add(input->sample);
}

void ControllerNode::OnBattery(const sensor_msgs::BatteryState::ConstPtr& message) {
  ++report_.battery.received;
  const std::optional<BatterySample> sample = ToInput(*message);
  if (!sample) {
    ++report_.battery.refused;
    return;
  }
  if (Admit(sample->stamp, &battery_clock_, &report_.battery)) controller_.Add(*sample);
}

void ControllerNode::OnReference(const FlatOutput::ConstPtr& message) {
  ++report_.references.received;
  const std::optional<TimedReference> reference = ToReference(*message);
  if (!reference) {
    ++report_.references.refused;
    ROS_WARN_THROTTLE(5.0, "a reference was refused: no stamp or not finite");
    return;
  }
  if (HasCome(reference->stamp, &report_.references)) references_.Add(*reference);
}

void ControllerNode::OnTrajectory(
    const trajectory_msgs::MultiDOFJointTrajectory::ConstPtr& message) {
  ++report_.references.received;
  std::string error;
  std::optional<std::vector<TimedReference>> points = ToReferences(*message, Now(), &error);
  if (points) {
    references_.Add(*std::move(points));
  } else {
    ++report_.references.refused;
    ROS_WARN_THROTTLE(5.0, "refused: %s", error.c_str());
  }
}

void ControllerNode::OnAccepted(const DynamicParameters::ConstPtr& message) {
  ++report_.estimates.received;
  const std::optional<ParameterSet> set = ToParameterSet(*message);
  const std::string objection =
      set ? ObjectionTo(*message, setup_.vehicle.name) : "no stamp or not finite";
  if (!objection.empty()) {
    ++report_.estimates.refused;
    ROS_WARN_THROTTLE(5.0, "an estimate was refused: %s", objection.c_str());
    return;
  }
  if (report_.uses_estimate) handover_.Consider(*set, FromRos(message->header.stamp), Now());
}

bool ControllerNode::OnResetParameters(std_srvs::Trigger::Request&,
                                       std_srvs::Trigger::Response& answer) {
  BackToNominal(Now());
  answer.success = true;
  answer.message = report_.uses_estimate
                       ? "back to the vehicle file; the next accepted estimate is followed again"
                       : "back to the vehicle file";
  return true;
}

bool ControllerNode::OnUseEstimate(std_srvs::SetBool::Request& request,
                                   std_srvs::SetBool::Response& answer) {
  report_.uses_estimate = request.data;
  if (!request.data) BackToNominal(Now());
  answer.success = true;
  answer.message = request.data ? "accepted estimates are followed"
                                : "back to the vehicle file; estimates are ignored";
  return true;
}

void ControllerNode::BackToNominal(Stamp now) {
  handover_.Reset(now);
  controller_.SetModel(handover_.model(), handover_.values());
}

// ---- Control -----------------------------------------------------------------------------------

void ControllerNode::StepIfDue(Stamp now, bool on_imu) {
  WatchClock(now);
  if (now <= 0) return;
  const double period_s = 1.0 / setup_.options.control_rate_hz;
  const double since_s = last_step_ ? ToSeconds(now - *last_step_) : 1.0;
  const bool imu_drives =
      imu_period_s_ < 1.25 * period_s && ToSeconds(now - imu_clock_.newest()) < kImuPatience_s;
  const bool is_due =
      since_s >= kDue * period_s && (on_imu || !imu_drives || since_s > kImuPatience_s);
  if (!is_due) return;
  if (last_step_ && since_s > kLate * period_s) ++report_.late_steps;
  last_step_ = now;
  Step(now);
}

void ControllerNode::Step(Stamp now) {
  const auto start = std::chrono::steady_clock::now();
  if (setup_.saved && report_.uses_estimate) {
    handover_.Consider(*setup_.saved, now, now);
    setup_.saved.reset();
  }
  const std::optional<FlatReference> reference = references_.At(now);
  Track(now, reference);
  if (handover_.Update(now, reference && !reference->standing && report_.has_state
                                ? std::optional<double>(report_.tracking_error_m)
                                : std::nullopt)) {
    controller_.SetModel(handover_.model(), handover_.values());
  }
  PublishCommand(controller_.Update(now, reference));
  const bool has_news = TakeEvents();
  const bool is_due = !last_status_ || ToSeconds(now - *last_status_) >= kStatusPeriod_s;
  if (has_news || is_due) PublishStatus(now);
  const std::chrono::duration<double, std::milli> took = std::chrono::steady_clock::now() - start;
  report_.step_ms_max = std::max(report_.step_ms_max, took.count());
  ++report_.steps;
}

// How far the vehicle is from the reference, as the controller sees it.
void ControllerNode::Track(Stamp now, const std::optional<FlatReference>& reference) {
  const std::optional<BodyState> state = controller_.StateAt(now);
  report_.has_state = state && state->p_WB.allFinite();
  report_.has_reference = reference.has_value();
  report_.reference_lost = references_.IsLost(now);
  const bool tracks = report_.has_state && reference && !reference->standing;
  report_.tracking_error_m = tracks ? (state->p_WB - reference->p_WB).norm() : 0.0;
}

void ControllerNode::PublishCommand(const ControlCommand& command) {
  if (!IsFinite(command)) {
    ++report_.not_finite;
    ROS_ERROR_THROTTLE(1.0, "a command is not finite and is not published");
    return;
  }
  report_.command = command;
  rotor_publisher_.publish(RotorCommand(command));
  if (motor_publisher_) motor_publisher_.publish(MotorCommand(command));
  rate_publisher_.publish(RateThrustCommand(command, setup_.options.body_frame));
}

// Returns true if anything happened.
bool ControllerNode::TakeEvents() {
  const std::vector<HandoverEvent> events = handover_.TakeEvents();
  for (const HandoverEvent& event : events) {
    const bool is_transition = event.from != event.to;
    report_.last_transition = is_transition ? std::string(NameOf(event.from)) + " to " +
                                                  NameOf(event.to) + ": " + event.reason
                                            : event.reason;
    if (is_transition) {
      ROS_INFO("parameters: %s", report_.last_transition.c_str());
    } else {
      ROS_INFO_THROTTLE(1.0, "parameters: %s", report_.last_transition.c_str());
    }
  }
  return !events.empty();
}

void ControllerNode::PublishStatus(Stamp now) {
  last_status_ = now;
  report_.handover = handover_.state();
  report_.progress = handover_.progress();
  report_.estimate_stamp = handover_.estimate_stamp();
  report_.tracking_rmse_m = handover_.tracking_rmse_m();
  report_.estimates_declined = handover_.refused();
  report_.odometry_jumps = controller_.jumps();
  status_publisher_.publish(ToMessage(report_, setup_.options.body_frame));
}

void ControllerNode::PublishDiagnostics() {
  diagnostic_msgs::DiagnosticArray message;
  message.header.stamp = ros::Time::now();
  message.status.push_back(
      ControllerDiagnostic(report_, refused_before_, ros::this_node::getName() + ": controller"));
  message.status.back().hardware_id = setup_.vehicle.name;
  diagnostics_publisher_.publish(message);
  refused_before_ = RefusedInput(report_);
  report_.step_ms_max = 0.0;
}

}  // namespace odmc
