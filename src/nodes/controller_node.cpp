// Flies a vehicle along a reference, with accepted estimates of its dynamic model. See
// launch/controller.launch.

#include "odmc/ros/controller_node.h"

#include <ros/init.h>

#include "odmc/ros/run_node.h"

namespace {

odmc::NodeHelp Help() {
  odmc::NodeHelp help;
  help.name = "controller_node";
  help.purpose = "flies a vehicle along a reference, with accepted estimates of its model.";
  help.commands = {"rosrun odmc controller_node _vehicle_file:=VEHICLE.yaml [_KEY:=VALUE ...]",
                   "roslaunch odmc controller.launch vehicle:=NAME"};
  help.subscribes = {
      {"odometry", {"nav_msgs/Odometry"}, "with velocity"},
      {"imu", {"sensor_msgs/Imu"}, ""},
      {"rotor_speeds", {"odmc/RotorSpeeds"}, "measured"},
      {"reference", {"odmc/FlatOutput"}, "position to snap, yaw"},
      {"command_trajectory",
       {"trajectory_msgs/MultiDOFJointTrajectory"},
       "where there is no reference"},
      {"parameters_accepted", {"odmc/DynamicParameters"}, "of the estimator"},
      {"battery_state", {"sensor_msgs/BatteryState"}, "used where the vehicle has an actuator"},
  };
  help.publishes = {
      {"command/rotor_speeds", {"odmc/RotorSpeeds"}, "rad/s"},
      {"command/rate_thrust", {"odmc/RateThrust"}, "rad/s, N"},
      {"motor_commands",
       {"odmc/MotorCommands"},
       "throttle 0 to 1, where the vehicle has an actuator"},
      {"controller_status",
       {"odmc/ControllerStatus"},
       "mode, hand-over state, tracking error, last transition"},
      {"/diagnostics", {"diagnostic_msgs/DiagnosticArray"}, ""},
  };
  help.services = {
      {"~reset_parameters", {"std_srvs/Trigger"}, "back to the vehicle file's values"},
      {"~use_estimate", {"std_srvs/SetBool"}, "follow accepted estimates or not"},
  };
  help.parameters = odmc::DefaultsOf<odmc::ControllerNodeOptions>();
  help.config_parameter = "config";
  help.config_example = "config/controller/default.yaml";
  help.config = odmc::DefaultsOf<odmc::ControllerConfig>();
  return help;
}

}  // namespace

int main(int argc, char** argv) {
  return odmc::RunNode(argc, argv, Help(),
                       [](const ros::NodeHandle& node, const ros::NodeHandle& private_node) {
                         const odmc::ControllerNode controller(
                             node, private_node, odmc::ReadControllerNodeSetup(private_node));
                         ros::spin();
                       });
}
