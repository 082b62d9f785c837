#pragma once

#include <diagnostic_msgs/DiagnosticStatus.h>
#include <ros/node_handle.h>
#include <ros/service_server.h>
#include <ros/subscriber.h>
#include <std_srvs/SetBool.h>
#include <std_srvs/Trigger.h>

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "odmc/MotorCommands.h"
#include "odmc/RotorSpeeds.h"
#include "odmc/model/dynamic_model.h"
#include "odmc/ros/guarded.h"
#include "odmc/ros/simulator_publisher.h"
#include "odmc/sim/world.h"
#include "odmc/trajectory/trajectory.h"

namespace odmc {

/// Private parameters of simulator_node, besides those of WorldOptions.
struct SimulatorNodeOptions {
  std::string vehicle_file;  ///< vehicle YAML
  std::string world_file;    ///< YAML of WorldOptions; empty: defaults
  std::string truth_file;    ///< effects and true values, parameters.yaml; empty: DefaultTruth()
  TrajectoryOptions trajectory;
  int seed = 1;
  double real_time_factor = 1.0;  ///< simulated over real time, > 0
  bool publishes_clock = true;    ///< false: stamps are of the machine's clock
  bool waits_for_controller =
      true;  ///< time starts when somebody takes odometry and sends commands
  /// Time goes no further beyond the newest command, as long as commands come at all; 0: it does.
  double command_lag_s = 0.02;
  std::string world_frame = "world";
  std::string body_frame = "base_link";

  template <typename Visitor>
  void Visit(Visitor* v) {
    v->Field("vehicle_file", &vehicle_file);
    v->Field("world_file", &world_file);
    v->Field("truth_file", &truth_file);
    v->Field("trajectory", &trajectory.name);
    v->Field("ground_s", &trajectory.ground_s);
    v->Field("top_speed_m_s", &trajectory.top_speed_m_s);
    v->Field("duration_s", &trajectory.duration_s);
    v->Field("seed", &seed);
    v->Field("real_time_factor", &real_time_factor);
    v->Field("publishes_clock", &publishes_clock);
    v->Field("waits_for_controller", &waits_for_controller);
    v->Field("command_lag_s", &command_lag_s);
    v->Field("world_frame", &world_frame);
    v->Field("body_frame", &body_frame);
  }

  /// True if usable; otherwise false with a sentence for the user in `error`.
  bool IsValid(std::string* error) const;
};

/// Everything the node reads before it starts.
struct SimulatorNodeSetup {
  SimulatorNodeOptions options;
  WorldOptions world;
  Vehicle vehicle;  ///< as it truly is
};

/// Reads private parameters, world, vehicle and truth.
/// @throws std::invalid_argument with a sentence for the user
SimulatorNodeSetup ReadSimulatorNodeSetup(const ros::NodeHandle& private_node);

/// A vehicle in its world, on ROS. One thread steps in real time and publishes what sensors
/// deliver; where the machine is too slow, the clock slows down and no step is left out. Commands
/// and services come in on ROS' threads. A vehicle with an actuator follows motor_commands; its
/// rotor speeds are commanded only while nobody publishes these.
class SimulatorNode {
 public:
  /// @throws std::invalid_argument with a sentence for the user
  SimulatorNode(const ros::NodeHandle& node, const ros::NodeHandle& private_node,
                SimulatorNodeSetup setup);
  ~SimulatorNode();
  SimulatorNode(const SimulatorNode&) = delete;
  SimulatorNode& operator=(const SimulatorNode&) = delete;

 private:
  using Clock = std::chrono::steady_clock;

  // ROS threads.
  void SubscribeAndServe();
  void AdvertiseFault(const std::string& service,
                      std::string (*act)(const WorldOptions& sizes, World* world));
  void OnCommand(const RotorSpeeds::ConstPtr& message);
  void OnMotorCommand(const MotorCommands::ConstPtr& message);
  void Obey(Stamp stamp, const RotorVector& values, bool is_throttle);
  void Refuse(const std::string& what);
  bool OnPause(std_srvs::SetBool::Request& request, std_srvs::SetBool::Response& response);
  WorldOptions Sizes() const;

  // Stepping thread.
  void Run();
  bool MayStep();
  bool HasController() const;
  bool WaitForCommand();
  void StepBatch();
  void ObeyCommand(World* world);
  void Pace();
  void Publish();
  void PublishDiagnostics();
  diagnostic_msgs::DiagnosticStatus Diagnostic(double factor);

  // Set once in the constructor.
  SimulatorNodeSetup setup_;
  DynamicModel model_;
  ModelValues truth_;
  Trajectory trajectory_;
  Stamp epoch_ = 0;  // of the world's time 0 on ROS
  ros::NodeHandle node_, private_node_;
  ros::Subscriber command_subscriber_, motor_subscriber_;  // the second: with an actuator
  std::vector<ros::ServiceServer> services_;

  struct Command {
    Stamp stamp;         // in the world's time
    RotorVector values;  // throttles, or speeds [rad/s]
    bool is_throttle;
  };
  struct CommandState {
    std::optional<Command> newest;
    long commands = 0, refused = 0;
    bool stopping = false;
  };

  // Shared by the threads. Where both are held, the world is locked first.
  Guarded<World> world_;
  Guarded<CommandState> command_state_;
  std::condition_variable command_changed_;
  std::atomic<bool> paused_{false};

  // Owned by the stepping thread.
  SimulatorPublisher publisher_;
  Stamp now_ = 0;  // the world's time
  bool started_ = false, locked_ = true, rotors_stopped_ = false;
  Stamp obeyed_ = 0;
  Clock::time_point pace_wall_, reported_wall_;
  Stamp pace_time_ = 0, reported_time_ = 0;
  long batches_ = 0, slow_downs_ = 0;

  std::thread thread_;  // started last, joined first
};

}  // namespace odmc
