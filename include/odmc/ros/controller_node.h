#pragma once

#include <nav_msgs/Odometry.h>
#include <ros/node_handle.h>
#include <ros/publisher.h>
#include <ros/service_server.h>
#include <ros/subscriber.h>
#include <ros/timer.h>
#include <ros/wall_timer.h>
#include <sensor_msgs/BatteryState.h>
#include <sensor_msgs/Imu.h>
#include <std_srvs/SetBool.h>
#include <std_srvs/Trigger.h>
#include <trajectory_msgs/MultiDOFJointTrajectory.h>

#include <optional>
#include <string>
#include <vector>

#include "odmc/DynamicParameters.h"
#include "odmc/FlatOutput.h"
#include "odmc/RotorSpeeds.h"
#include "odmc/control/controller_options.h"
#include "odmc/control/flatness_controller.h"
#include "odmc/control/parameter_handover.h"
#include "odmc/ros/controller_report.h"
#include "odmc/ros/conversions.h"
#include "odmc/ros/reference_intake.h"
#include "odmc/sensing/topic_clock.h"
#include "odmc/sensing/twist_frame.h"

namespace odmc {

/// Private parameters of controller_node, besides those of ControllerConfig.
struct ControllerNodeOptions {
  std::string vehicle_file;        ///< vehicle YAML
  std::string config;              ///< YAML of ControllerConfig; empty: defaults
  std::string parameters_file;     ///< a saved set to start with; empty: the vehicle file's values
  double control_rate_hz = 500.0;  ///< steps on IMU samples, else on a timer [Hz], 50 to 2000
  bool use_estimate = true;        ///< follow parameters_accepted
  std::string twist_frame = "body";  ///< of the odometry's velocity: body | world | auto
  double reference_timeout_s = 0.5;  ///< silence after which the last place is held, > 0
  std::string body_frame = "base_link";

  template <typename Visitor>
  void Visit(Visitor* v) {
    v->Field("vehicle_file", &vehicle_file);
    v->Field("config", &config);
    v->Field("parameters_file", &parameters_file);
    v->Field("control_rate_hz", &control_rate_hz);
    v->Field("use_estimate", &use_estimate);
    v->Field("twist_frame", &twist_frame);
    v->Field("reference_timeout_s", &reference_timeout_s);
    v->Field("body_frame", &body_frame);
  }

  /// True if usable; otherwise false with a sentence for the user in `error`.
  bool IsValid(std::string* error) const;
};

/// What config/controller/*.yaml holds.
struct ControllerConfig {
  ControllerOptions controller;
  HandoverOptions handover;

  template <typename Visitor>
  void Visit(Visitor* v) {
    controller.Visit(v);
    handover.Visit(v);
  }

  bool IsValid(std::string* error) const {
    return controller.IsValid(error) && handover.IsValid(error);
  }
};

/// Everything the node reads before it starts.
struct ControllerNodeSetup {
  ControllerNodeOptions options;
  ControllerConfig config;
  Vehicle vehicle;                    ///< nominal
  std::optional<ParameterSet> saved;  ///< to start with
};

/// Reads private parameters, configuration, vehicle and saved parameters.
/// @throws std::invalid_argument with a sentence for the user
ControllerNodeSetup ReadControllerNodeSetup(const ros::NodeHandle& private_node);

/// The controller on ROS: odometry, IMU, rotor speeds and a reference in; rotor speeds out, and
/// body rates with thrust for vehicles that close the inner loop themselves. Where the vehicle has
/// an actuator: battery voltage in, throttles out. Uses accepted estimates through a
/// ParameterHandover. Everything runs on the one thread that spins; a step takes a fraction of a
/// millisecond. Links no solver.
class ControllerNode {
 public:
  /// @throws std::invalid_argument with a sentence for the user
  ControllerNode(const ros::NodeHandle& node, const ros::NodeHandle& private_node,
                 ControllerNodeSetup setup);

 private:
  void Subscribe();
  void Advertise(ros::NodeHandle private_node);

  void OnOdometry(const nav_msgs::Odometry::ConstPtr& message);
  void OnImu(const sensor_msgs::Imu::ConstPtr& message);
  void OnRotors(const RotorSpeeds::ConstPtr& message);
  void OnBattery(const sensor_msgs::BatteryState::ConstPtr& message);
  void OnReference(const FlatOutput::ConstPtr& message);
  void OnTrajectory(const trajectory_msgs::MultiDOFJointTrajectory::ConstPtr& message);
  void OnAccepted(const DynamicParameters::ConstPtr& message);
  bool OnResetParameters(std_srvs::Trigger::Request& request, std_srvs::Trigger::Response& answer);
  bool OnUseEstimate(std_srvs::SetBool::Request& request, std_srvs::SetBool::Response& answer);

  bool HasCome(Stamp stamp, ControlInput* input);
  /// True if a sample of this stamp may be used. Sees the clock step back.
  bool Admit(Stamp stamp, TopicClock* clock, ControlInput* input);
  void WatchClock(Stamp now);
  void OnClockStepBack();
  TwistFrame FrameOf(const OdometryInput& input);
  void MeasureImuRate(Stamp since_last);
  void StepIfDue(Stamp now, bool on_imu);
  void Step(Stamp now);
  void Track(Stamp now, const std::optional<FlatReference>& reference);
  void BackToNominal(Stamp now);
  void PublishCommand(const ControlCommand& command);
  bool TakeEvents();
  void PublishStatus(Stamp now);
  void PublishDiagnostics();

  ControllerNodeSetup setup_;
  ParameterHandover handover_;
  FlatnessController controller_;
  ReferenceIntake references_;
  std::optional<TwistFrameDetector> twist_;  // always there; made anew where the clock steps back
  ControllerReport report_;

  TopicClock odometry_clock_, imu_clock_, rotor_clock_, battery_clock_;
  Stamp newest_now_ = 0;
  double imu_period_s_ = 1.0;  // of the newest samples
  std::optional<Stamp> last_step_, last_status_;
  long refused_before_ = 0;  // at the last report

  ros::NodeHandle node_;
  std::vector<ros::Subscriber> subscribers_;
  std::vector<ros::ServiceServer> services_;
  ros::Publisher rotor_publisher_, motor_publisher_, rate_publisher_, status_publisher_,
      diagnostics_publisher_;
  ros::Timer step_timer_;
  ros::WallTimer report_timer_;
};

}  // namespace odmc
