// A vehicle in its simulated world, flown by whoever sends rotor speeds. See
// launch/simulation.launch.

#include "odmc/ros/simulator_node.h"

#include <ros/init.h>

#include "odmc/ros/run_node.h"

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
  return odmc::RunNode(argc, argv, "simulator_node", kHelp,
                       [](const ros::NodeHandle& node, const ros::NodeHandle& private_node) {
                         const odmc::SimulatorNode simulator(
                             node, private_node, odmc::ReadSimulatorNodeSetup(private_node));
                         ros::spin();
                       });
}
