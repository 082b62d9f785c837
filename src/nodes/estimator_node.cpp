// Estimates the dynamic model of a flying vehicle, live. See launch/estimator.launch.

#include "odmc/ros/estimator_node.h"

#include <ros/init.h>

#include <stdexcept>

#include "odmc/ros/run_node.h"

namespace {

constexpr char kHelp[] =
    "estimator_node: estimates the dynamic model of a flying vehicle, live.\n"
    "\n"
    "  rosrun odmc estimator_node _vehicle_file:=VEHICLE.yaml [_KEY:=VALUE ...]\n"
    "  roslaunch odmc estimator.launch vehicle:=NAME\n"
    "\n"
    "Subscribes odometry or pose (and twist), imu, rotor_speeds or joint_states, battery_state,\n"
    "           motor_commands; messages of other packages, too: docs/messages.md.\n"
    "Publishes  parameters, parameters_accepted, state, residual_wrench, unexplained,\n"
    "           live_image, /diagnostics.\n"
    "Services   ~reset, ~freeze, ~accept, ~save.\n"
    "Parameters: see launch/estimator.launch and config/estimator.yaml.\n";

}  // namespace

int main(int argc, char** argv) {
  return odmc::RunNode(argc, argv, "estimator_node", kHelp,
                       [](const ros::NodeHandle& node, const ros::NodeHandle& private_node) {
                         odmc::EstimatorNode estimator(
                             node, private_node, odmc::ReadEstimatorNodeSetup(node, private_node));
                         ros::spin();
                         if (!estimator.Stop()) throw std::runtime_error("see above");
                       });
}
