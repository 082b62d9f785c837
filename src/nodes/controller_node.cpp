// Flies a vehicle along a reference, with accepted estimates of its dynamic model. See
// launch/controller.launch.

#include "odmc/ros/controller_node.h"

#include <ros/init.h>

#include "odmc/ros/run_node.h"

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
  return odmc::RunNode(argc, argv, "controller_node", kHelp,
                       [](const ros::NodeHandle& node, const ros::NodeHandle& private_node) {
                         const odmc::ControllerNode controller(
                             node, private_node, odmc::ReadControllerNodeSetup(private_node));
                         ros::spin();
                       });
}
