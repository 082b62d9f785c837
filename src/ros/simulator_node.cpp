#include "odmc/ros/simulator_node.h"

#include <ros/console.h>
#include <ros/init.h>

#include <cstdio>
#include <stdexcept>
#include <utility>

#include "odmc/io/parameters_yaml.h"
#include "odmc/io/vehicle_yaml.h"
#include "odmc/ros/control_messages.h"
#include "odmc/ros/conversions.h"
#include "odmc/ros/diagnostic_values.h"
#include "odmc/ros/node_options.h"
#include "odmc/ros/parameter_reader.h"
#include "odmc/sim/truth_vehicle.h"
#include "odmc/text/format.h"
#include "odmc/text/number_text.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

constexpr double kBatch_s = 0.002;  // between two messages of the clock
// Every so many batches:
constexpr long kTruthBatches = 2, kPointBatches = 5, kTfBatches = 10;  // 250, 100, 50 Hz
constexpr double kOldCommand_s = 0.25;                                 // rotors stop
constexpr Stamp kStartOfClock = 1000000000;                            // ROS takes 0 for "no stamp"
constexpr std::chrono::milliseconds kIdle(20);
constexpr std::chrono::milliseconds kLongestWait(500);  // for one command
constexpr std::chrono::milliseconds kMostCatchingUp(20);
constexpr double kSlow = 0.9;  // of the real-time factor asked for

using std::chrono::duration;

double ElapsedSeconds(std::chrono::steady_clock::time_point since) {
  return duration<double>(std::chrono::steady_clock::now() - since).count();
}

ModelValues TruthOf(const DynamicModel& model, const SimulatorNodeOptions& options) {
  return options.truth_file.empty() ? DefaultTruth(model) : model.InitialValues();
}

Stamp EpochOf(const SimulatorNodeOptions& options) {
  return options.publishes_clock ? kStartOfClock : FromRos(ros::Time(ros::WallTime::now().toSec()));
}

std::string VectorText(const Eigen::Vector3d& v) {
  char text[80];
  std::snprintf(text, sizeof text, "(%.3g, %.3g, %.3g) m", v.x(), v.y(), v.z());
  return text;
}

// ---- Services: each says what it did, or throws ------------------------------------------------

// Of the vehicle's mass and arm, and of thrust, where the world does not say.
constexpr double kPayloadShare = 0.2, kShift = 0.1, kDamageShare = 0.1, kJump_m = 0.5;
constexpr double kMostPayload_kg = 1000.0;

std::string AttachPayload(const WorldOptions& sizes, World* world) {
  if (!(sizes.payload_kg > 0.0 && sizes.payload_kg <= kMostPayload_kg)) {
    throw std::invalid_argument("payload_kg must be above 0 and at most " +
                                FormatNumber(kMostPayload_kg));
  }
  world->AttachPayload(sizes.payload_kg, sizes.payload_p_B_m);
  return Rounded(sizes.payload_kg) + " kg hang at " + VectorText(sizes.payload_p_B_m);
}

std::string DropPayload(const WorldOptions&, World* world) {
  world->DropPayload();
  return "the payload is off";
}

std::string ShiftCentreOfGravity(const WorldOptions& sizes, World* world) {
  const Eigen::Vector3d& by_m = sizes.cog_shift_m;
  if (by_m.isZero(0.0)) throw std::invalid_argument("cog_shift_m is zero: nothing to shift by");
  world->ShiftCentreOfGravity(by_m);
  return "the centre of gravity moved by " + VectorText(by_m);
}

std::string DamagePropeller(const WorldOptions& sizes, World* world) {
  if (!(sizes.damage_share > 0.0)) throw std::invalid_argument("damage_share must be set above 0");
  const auto rotors = static_cast<int>(world->HoverSpeeds().size());
  if (sizes.damage_rotor < 1 || sizes.damage_rotor > rotors) {
    throw std::invalid_argument("damage_rotor must be 1 to " + std::to_string(rotors));
  }
  world->DamagePropeller(sizes.damage_rotor - 1, sizes.damage_share);
  return "rotor " + std::to_string(sizes.damage_rotor) + " lost a share of " +
         Rounded(sizes.damage_share);
}

std::string Repair(const WorldOptions&, World* world) {
  world->Repair();
  return "all propellers are new";
}

std::string JumpOdometry(const WorldOptions& sizes, World* world) {
  const Eigen::Vector3d& by_m = sizes.jump_m;
  if (by_m.isZero(0.0)) throw std::invalid_argument("jump_m is zero: nothing to jump by");
  world->JumpOdometry(by_m);
  return "the odometry jumped by " + VectorText(by_m);
}

}  // namespace

// ---- Set-up ------------------------------------------------------------------------------------

bool SimulatorNodeOptions::IsValid(std::string* error) const {
  if (vehicle_file.empty()) return Invalid(error, "vehicle_file must name a vehicle YAML");
  if (!(real_time_factor > 0.0)) return Invalid(error, "real_time_factor must be positive");
  if (!(command_lag_s >= 0.0))
    return Invalid(error, "command_lag_s must be positive, or 0 not to wait");
  if (world_frame.empty() || body_frame.empty()) {
    return Invalid(error, "world_frame and body_frame must not be empty");
  }
  return trajectory.IsValid(error);
}

SimulatorNodeSetup ReadSimulatorNodeSetup(const ros::NodeHandle& private_node) {
  SimulatorNodeSetup setup;
  ReadNodeOptions(private_node, &SimulatorNodeOptions::world_file, &setup.options, &setup.world);
  std::string error;
  const auto fail = [&] {
    throw std::invalid_argument(private_node.getNamespace() + ": " + error);
  };
  if (!setup.options.IsValid(&error)) fail();
  const TrajectoryOptions& trajectory = setup.options.trajectory;
  if (trajectory.ground_s > 0.0 && setup.world.start_height_m > 0.0) {
    error =
        "ground_s and start_height_m contradict each other: the flight starts on the ground or "
        "in hover";
    fail();
  }
  if (trajectory.ground_s == 0.0 && setup.world.start_height_m == 0.0) {
    setup.world.start_height_m = Trajectory(trajectory).At(0.0).p_WB.z();
  }
  if (!setup.world.IsValid(&error)) fail();
  setup.vehicle = LoadVehicle(setup.options.vehicle_file);
  if (!setup.options.truth_file.empty()) {
    ApplyParameters(LoadParameters(setup.options.truth_file), &setup.vehicle);
  }
  return setup;
}

SimulatorNode::SimulatorNode(const ros::NodeHandle& node, const ros::NodeHandle& private_node,
                             SimulatorNodeSetup setup)
    : setup_(std::move(setup)),
      model_(setup_.vehicle, setup_.vehicle.effects),
      truth_(TruthOf(model_, setup_.options)),
      trajectory_(setup_.options.trajectory),
      epoch_(EpochOf(setup_.options)),
      node_(node),
      private_node_(private_node),
      world_(model_, truth_, setup_.world, setup_.options.seed),
      publisher_(node_,
                 SimulatorFrames::Of(setup_.vehicle, setup_.options.world_frame,
                                     setup_.options.body_frame),
                 epoch_, setup_.options.publishes_clock) {
  SubscribeAndServe();
  publisher_.PublishStart(setup_.vehicle, model_, truth_, trajectory_,
                          setup_.options.trajectory.ground_s);
  pace_wall_ = reported_wall_ = Clock::now();
  thread_ = std::thread(&SimulatorNode::Run, this);
}

SimulatorNode::~SimulatorNode() {
  command_state_.With([](CommandState* state) { state->stopping = true; });
  command_changed_.notify_all();
  thread_.join();
}

void SimulatorNode::SubscribeAndServe() {
  command_subscriber_ = node_.subscribe("command/rotor_speeds", 10, &SimulatorNode::OnCommand, this,
                                        ros::TransportHints().tcpNoDelay());
  if (world_.With([](World* world) { return world->has_actuator(); })) {
    motor_subscriber_ = node_.subscribe("motor_commands", 10, &SimulatorNode::OnMotorCommand, this,
                                        ros::TransportHints().tcpNoDelay());
  }

  AdvertiseFault("attach_payload", AttachPayload);
  AdvertiseFault("drop_payload", DropPayload);
  AdvertiseFault("shift_cog", ShiftCentreOfGravity);
  AdvertiseFault("damage_propeller", DamagePropeller);
  AdvertiseFault("repair", Repair);
  AdvertiseFault("jump_odometry", JumpOdometry);
  services_.push_back(private_node_.advertiseService("pause", &SimulatorNode::OnPause, this));
}

// ---- ROS threads -------------------------------------------------------------------------------

void SimulatorNode::AdvertiseFault(const std::string& service,
                                   std::string (*act)(const WorldOptions& sizes, World* world)) {
  const boost::function<bool(std_srvs::Trigger::Request&, std_srvs::Trigger::Response&)> callback =
      [this, service, act](std_srvs::Trigger::Request&, std_srvs::Trigger::Response& answer) {
        try {
          const WorldOptions sizes = Sizes();
          answer.message = world_.With([&](World* world) { return act(sizes, world); });
          answer.success = true;
          ROS_INFO("%s: %s", service.c_str(), answer.message.c_str());
        } catch (const std::exception& e) {
          answer.success = false;
          answer.message = e.what();
        }
        return true;
      };
  services_.push_back(private_node_.advertiseService(service, callback));
}

// They may be set anew before each call.
WorldOptions SimulatorNode::Sizes() const {
  // What the world does not say is something to see.
  WorldOptions sizes = setup_.world;
  if (sizes.payload_kg == 0.0) sizes.payload_kg = kPayloadShare * setup_.vehicle.mass_kg;
  if (sizes.damage_share == 0.0) sizes.damage_share = kDamageShare;
  if (sizes.cog_shift_m.isZero(0.0)) sizes.cog_shift_m.x() = kShift * setup_.vehicle.ArmLength();
  if (sizes.jump_m.isZero(0.0)) sizes.jump_m.x() = kJump_m;
  ParameterReader reader(private_node_);
  sizes.Visit(&reader);
  return sizes;
}

bool SimulatorNode::OnPause(std_srvs::SetBool::Request& request,
                            std_srvs::SetBool::Response& response) {
  paused_ = request.data;
  response.success = true;
  response.message = request.data ? "time stands" : "time runs";
  return true;
}

void SimulatorNode::OnCommand(const RotorSpeeds::ConstPtr& message) {
  if (motor_subscriber_ && motor_subscriber_.getNumPublishers() > 0) return;
  const std::optional<RotorInput> input = ToInput(*message, model_.vehicle().num_rotors());
  input ? Obey(input->sample.stamp, input->sample.speed, false) : Refuse("speed");
}

void SimulatorNode::OnMotorCommand(const MotorCommands::ConstPtr& message) {
  const std::optional<CommandSample> input = ToInput(*message, model_.vehicle().num_rotors());
  input ? Obey(input->stamp, input->throttle, true) : Refuse("throttle");
}

void SimulatorNode::Obey(Stamp stamp, const RotorVector& values, bool is_throttle) {
  command_state_.With([&](CommandState* state) {
    ++state->commands;
    state->newest = Command{stamp - epoch_, values, is_throttle};
  });
  command_changed_.notify_one();
}

void SimulatorNode::Refuse(const std::string& what) {
  command_state_.With([](CommandState* state) { ++state->refused; });
  ROS_WARN_THROTTLE(1.0,
                    "a command was refused: it must have a stamp and one finite %s for each of %d "
                    "rotors",
                    what.c_str(), model_.vehicle().num_rotors());
  command_changed_.notify_one();
}

// ---- Stepping thread ---------------------------------------------------------------------------

void SimulatorNode::Run() {
  try {
    while (!command_state_.With([](const CommandState* state) { return state->stopping; })) {
      if (ElapsedSeconds(reported_wall_) >= 1.0) PublishDiagnostics();
      if (!MayStep()) {
        publisher_.PublishClock(now_);  // who comes now learns what time it is
        std::this_thread::sleep_for(kIdle);
        pace_wall_ = Clock::now();
        continue;
      }
      if (!WaitForCommand()) continue;
      StepBatch();
      Publish();
      Pace();
    }
  } catch (const std::exception& e) {
    ROS_FATAL("the simulation stopped: %s", e.what());
    ros::requestShutdown();
  }
}

bool SimulatorNode::MayStep() {
  if (paused_) return false;
  if (started_ || !setup_.options.waits_for_controller) return true;
  started_ = HasController();
  if (!started_) return false;
  ROS_INFO("a controller is there: time starts");
  reported_wall_ = Clock::now();  // what was waited for is not slowness
  return true;
}

bool SimulatorNode::HasController() const {
  return publisher_.somebody_takes_odometry() &&
         (command_subscriber_.getNumPublishers() > 0 ||
          (motor_subscriber_ && motor_subscriber_.getNumPublishers() > 0));
}

// Returns false where it has waited and should look again at what else happened.
bool SimulatorNode::WaitForCommand() {
  const double lag_s = setup_.options.command_lag_s;
  if (lag_s == 0.0) return true;
  if (!command_state_.With([](const CommandState* state) { return state->newest.has_value(); }))
    return true;
  const auto is_near = [&](const CommandState* state) {
    return state->stopping || ToSeconds(now_ - state->newest->stamp) <= lag_s;
  };
  if (command_state_.With(is_near)) {
    locked_ = true;
    return true;
  }
  if (!locked_) return true;
  ++slow_downs_;
  locked_ = command_state_.WaitFor(&command_changed_, kLongestWait, is_near);
  if (!locked_) ROS_WARN("no command for %.0f ms: time goes on without", 1e3 * lag_s);
  return false;
}

void SimulatorNode::StepBatch() {
  world_.With([this](World* world) {
    ObeyCommand(world);
    const Stamp end = (batches_ + 1) * FromSeconds(kBatch_s);
    while (world->now() < end) world->Step();
    now_ = world->now();
  });
  ++batches_;
}

void SimulatorNode::ObeyCommand(World* world) {
  const std::optional<Command> command =
      command_state_.With([](const CommandState* state) { return state->newest; });
  if (!command) return;
  const bool is_old = ToSeconds(now_ - command->stamp) > kOldCommand_s;
  if (is_old) {
    if (rotors_stopped_) return;
    world->Command(RotorVector::Zero(command->values.size()));
    ROS_WARN("the newest command is older than %.2f s: rotors stop", kOldCommand_s);
  } else if (command->stamp != obeyed_ || rotors_stopped_) {
    obeyed_ = command->stamp;
    command->is_throttle ? world->CommandThrottle(command->values)
                         : world->Command(command->values);
  }
  rotors_stopped_ = is_old;
}

void SimulatorNode::Pace() {
  const double ahead_s =
      ToSeconds(now_ - pace_time_) / setup_.options.real_time_factor - ElapsedSeconds(pace_wall_);
  if (ahead_s > 0.0) std::this_thread::sleep_for(duration<double>(ahead_s));
  if (ahead_s > -duration<double>(kMostCatchingUp).count()) return;
  pace_wall_ = Clock::now();  // too slow: what was lost is not caught up
  pace_time_ = now_;
}

void SimulatorNode::Publish() {
  std::vector<Sample> samples;
  std::optional<TruthSample> truth;
  Eigen::Vector3d wind_W;
  world_.With([&](World* world) {
    samples = world->TakeSamples();
    if (batches_ % kTruthBatches == 0) truth = world->Truth();
    wind_W = world->wind_W();
  });
  publisher_.PublishClock(now_);
  if (truth) {
    const FlatReference reference = trajectory_.At(ToSeconds(now_));
    publisher_.PublishReference(reference, now_);
    const bool points = batches_ % kPointBatches == 0 && !reference.standing;
    if (points) publisher_.PublishPoint(reference, now_);
    publisher_.PublishTruth(*truth, wind_W, now_);
    if (batches_ % kTfBatches == 0) publisher_.PublishTruthTransform(*truth, now_);
  }
  publisher_.PublishSamples(samples);
}

void SimulatorNode::PublishDiagnostics() {
  const double real_s = ElapsedSeconds(reported_wall_);
  const double factor = ToSeconds(now_ - reported_time_) / real_s;
  reported_wall_ = Clock::now();
  reported_time_ = now_;
  const diagnostic_msgs::DiagnosticStatus status = Diagnostic(factor);
  if (ros::ok()) publisher_.PublishDiagnostics(status, now_);
}

diagnostic_msgs::DiagnosticStatus SimulatorNode::Diagnostic(double factor) {
  using diagnostic_msgs::DiagnosticStatus;
  DiagnosticStatus status;
  status.name = ros::this_node::getName() + ": simulator";
  status.hardware_id = setup_.vehicle.name;
  const double asked = setup_.options.real_time_factor;
  const bool waits = setup_.options.waits_for_controller && !started_;
  const bool is_slow = !waits && !paused_ && factor < kSlow * asked;
  status.level = rotors_stopped_ ? DiagnosticStatus::ERROR
                 : is_slow       ? DiagnosticStatus::WARN
                                 : DiagnosticStatus::OK;
  status.message = rotors_stopped_ ? "no commands: rotors are stopped"
                   : is_slow       ? "the machine is too slow for the real-time factor asked for"
                   : waits         ? "waiting for a controller"
                   : paused_       ? "paused"
                                   : "running";
  PutValue("real_time_factor", factor, &status);
  PutValue("real_time_factor_asked", asked, &status);
  PutValue("time_s", ToSeconds(now_), &status);
  PutValue("trajectory", trajectory_.name(), &status);
  PutValue("waits_for_commands", slow_downs_, &status);
  world_.With([&](World* world) {
    PutValue("on_ground", world->touches_ground(), &status);
    PutValue("mass_kg", world->mass(), &status);
    PutValue("battery_voltage_V", world->battery_voltage_V(), &status);
  });
  command_state_.With([&](const CommandState* state) {
    PutValue("commands", state->commands, &status);
    PutValue("commands_refused", state->refused, &status);
    if (state->newest) PutValue("command_age_s", ToSeconds(now_ - state->newest->stamp), &status);
  });
  return status;
}

}  // namespace odmc
