// Flies a vehicle along a reference, with accepted estimates of its dynamic model. See
// launch/controller.launch.

#include "odmc/ros/controller_node.h"

#include <ros/console.h>
#include <ros/init.h>

#include <cstdio>
#include <cstring>
#include <exception>

namespace {

constexpr char kHelp[] =
    "controller_node: flies a vehicle along a reference, with accepted estimates of its model.\n"
    "\n"
    "  rosrun odmc controller_node _vehicle_file:=VEHICLE.yaml [_KEY:=VALUE ...]\n"
    "  roslaunch odmc controller.launch vehicle:=NAME\n"
    "\n"
    "Subscribes odometry, imu, rotor_speeds, reference or command_trajectory,\n"
    "           parameters_accepted.\n"
    "Publishes  command/rotor_speeds, command/rate_thrust, controller_status, /diagnostics.\n"
    "Services   ~reset_parameters, ~use_estimate.\n"
    "Parameters: see launch/controller.launch and config/controller/default.yaml.\n";

}  // namespace

int main(int argc, char** argv) {
  for (int i = 1; i < argc; ++i) {
    if (std::strcmp(argv[i], "--help") == 0 || std::strcmp(argv[i], "-h") == 0) {
      std::fputs(kHelp, stdout);
      return 0;
    }
  }
  ros::init(argc, argv, "controller_node");
  // Outside of `try`: the last handle takes the log with it.
  const ros::NodeHandle node, private_node("~");
  try {
    const odmc::ControllerNode controller(node, private_node,
                                          odmc::ReadControllerNodeSetup(private_node));
    ros::spin();
  } catch (const std::exception& e) {
    ROS_FATAL("%s", e.what());
    return 1;
  }
  return 0;
}
