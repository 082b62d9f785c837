// A vehicle in its simulated world, flown by whoever sends rotor speeds. See
// launch/simulation.launch.

#include "odmc/ros/simulator_node.h"

#include <ros/init.h>

#include "odmc/ros/run_node.h"

namespace {

odmc::NodeHelp Help() {
  odmc::NodeHelp help;
  help.name = "simulator_node";
  help.purpose = "simulates a vehicle in its world, flown by rotor speeds.";
  help.commands = {"rosrun odmc simulator_node _vehicle_file:=VEHICLE.yaml [_KEY:=VALUE ...]",
                   "roslaunch odmc simulation.launch vehicle:=NAME trajectory:=octo"};
  help.subscribes = {
      {"command/rotor_speeds", {"odmc/RotorSpeeds"}, ""},
      {"motor_commands",
       {"odmc/MotorCommands"},
       "instead, where the vehicle has an actuator, as soon as somebody publishes them"},
  };
  help.publishes = {
      {"/clock", {"rosgraph_msgs/Clock"}, ""},
      {"odometry", {"nav_msgs/Odometry"}, "as the sensor sees it"},
      {"imu", {"sensor_msgs/Imu"}, ""},
      {"rotor_speeds", {"odmc/RotorSpeeds"}, ""},
      {"battery_state", {"sensor_msgs/BatteryState"}, ""},
      {"reference", {"odmc/FlatOutput"}, "of the trajectory"},
      {"command_trajectory",
       {"trajectory_msgs/MultiDOFJointTrajectory"},
       "the same as one point, for other controllers"},
      {"planned_trajectory",
       {"trajectory_msgs/MultiDOFJointTrajectory"},
       "the whole path, latched"},
      {"truth/odometry", {"nav_msgs/Odometry"}, "of the body"},
      {"truth/wrench", {"geometry_msgs/WrenchStamped"}, ""},
      {"truth/wind", {"geometry_msgs/Vector3Stamped"}, ""},
      {"truth/parameters", {"odmc/DynamicParameters"}, "latched"},
      {"/diagnostics", {"diagnostic_msgs/DiagnosticArray"}, ""},
      {"/tf", {"tf2_msgs/TFMessage"}, "the body's true pose"},
      {"/tf_static", {"tf2_msgs/TFMessage"}, "mounts of the sensors"},
  };
  help.services = {
      {"~attach_payload", {"std_srvs/Trigger"}, "of payload_kg at payload_p_B_m"},
      {"~drop_payload", {"std_srvs/Trigger"}, ""},
      {"~shift_cog", {"std_srvs/Trigger"}, "by cog_shift_m"},
      {"~damage_propeller", {"std_srvs/Trigger"}, "damage_rotor loses damage_share"},
      {"~repair", {"std_srvs/Trigger"}, "all propellers"},
      {"~jump_odometry", {"std_srvs/Trigger"}, "by jump_m"},
      {"~pause", {"std_srvs/SetBool"}, "stops time"},
  };
  help.parameters = odmc::DefaultsOf<odmc::SimulatorNodeOptions>();
  help.config_parameter = "world_file";
  help.config_example = "config/worlds/default.yaml";
  help.config = odmc::DefaultsOf<odmc::WorldOptions>();
  return help;
}

}  // namespace

int main(int argc, char** argv) {
  return odmc::RunNode(argc, argv, Help(),
                       [](const ros::NodeHandle& node, const ros::NodeHandle& private_node) {
                         const odmc::SimulatorNode simulator(
                             node, private_node, odmc::ReadSimulatorNodeSetup(private_node));
                         ros::spin();
                       });
}
