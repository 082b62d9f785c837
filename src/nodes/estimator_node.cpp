// Estimates the dynamic model of a flying vehicle, live. See launch/estimator.launch.

#include "odmc/ros/estimator_node.h"

#include <ros/console.h>
#include <ros/init.h>

#include <cstdio>
#include <cstring>
#include <exception>

namespace {

constexpr char kHelp[] =
    "estimator_node: estimates the dynamic model of a flying vehicle, live.\n"
    "\n"
    "  rosrun odmc estimator_node _vehicle_file:=VEHICLE.yaml [_KEY:=VALUE ...]\n"
    "  roslaunch odmc estimator.launch vehicle:=NAME\n"
    "\n"
    "Subscribes odometry or pose, imu, rotor_speeds or joint_states, battery_state.\n"
    "Publishes  parameters, parameters_accepted, state, residual_wrench, unexplained,\n"
    "           live_image, /diagnostics.\n"
    "Services   ~reset, ~freeze, ~accept, ~save.\n"
    "Parameters: see launch/estimator.launch and config/estimator.yaml.\n";

}  // namespace

int main(int argc, char** argv) {
  for (int i = 1; i < argc; ++i) {
    if (std::strcmp(argv[i], "--help") == 0 || std::strcmp(argv[i], "-h") == 0) {
      std::fputs(kHelp, stdout);
      return 0;
    }
  }
  ros::init(argc, argv, "estimator_node");
  // Outside of `try`: the last handle takes the log with it.
  const ros::NodeHandle node, private_node("~");
  try {
    const odmc::EstimatorNode estimator(node, private_node,
                                        odmc::ReadEstimatorNodeSetup(node, private_node));
    ros::spin();
  } catch (const std::exception& e) {
    ROS_FATAL("%s", e.what());
    return 1;
  }
  return 0;
}
