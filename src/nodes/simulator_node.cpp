// A vehicle in its simulated world, flown by whoever sends rotor speeds. See
// launch/simulation.launch.

#include "odmc/ros/simulator_node.h"

#include <ros/console.h>
#include <ros/init.h>

#include <cstdio>
#include <cstring>
#include <exception>

namespace {

constexpr char kHelp[] =
    "simulator_node: a vehicle in its simulated world, flown by rotor speeds.\n"
    "\n"
    "  rosrun odmc simulator_node _vehicle_file:=VEHICLE.yaml [_KEY:=VALUE ...]\n"
    "  roslaunch odmc simulation.launch vehicle:=NAME trajectory:=octo\n"
    "\n"
    "Subscribes command/rotor_speeds.\n"
    "Publishes  /clock, odometry, imu, rotor_speeds, battery_state, reference,\n"
    "           command_trajectory, planned_trajectory, truth/odometry, truth/wrench,\n"
    "           truth/wind, truth/parameters, /diagnostics, tf.\n"
    "Services   ~attach_payload, ~drop_payload, ~shift_cog, ~damage_propeller, ~repair,\n"
    "           ~jump_odometry, ~pause.\n"
    "Parameters: see launch/simulation.launch and config/worlds/default.yaml.\n";

}  // namespace

int main(int argc, char** argv) {
  for (int i = 1; i < argc; ++i) {
    if (std::strcmp(argv[i], "--help") == 0 || std::strcmp(argv[i], "-h") == 0) {
      std::fputs(kHelp, stdout);
      return 0;
    }
  }
  ros::init(argc, argv, "simulator_node");
  // Outside of `try`: the last handle takes the log with it.
  const ros::NodeHandle node, private_node("~");
  try {
    const odmc::SimulatorNode simulator(node, private_node,
                                        odmc::ReadSimulatorNodeSetup(private_node));
    ros::spin();
  } catch (const std::exception& e) {
    ROS_FATAL("%s", e.what());
    return 1;
  }
  return 0;
}
