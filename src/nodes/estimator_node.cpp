// Estimates the dynamic model of a flying vehicle, live. See launch/estimator.launch.

#include "odmc/ros/estimator_node.h"

#include <ros/init.h>

#include <stdexcept>
#include <string>
#include <vector>

#include "odmc/ros/run_node.h"

namespace {

/// Streams as the node subscribes them, each with what is special about it.
std::vector<odmc::NodeEntry> Subscribed() {
  const auto remark = [](odmc::InputStream stream) -> std::string {
    using odmc::InputStream;
    switch (stream) {
      case InputStream::kOdometry:
        return "";
      case InputStream::kPose:
        return "where there is no odometry";
      case InputStream::kImu:
        return "optional";
      case InputStream::kRotorSpeeds:
        return "messages of other packages, too: docs/messages.md";
      case InputStream::kJointStates:
        return "where there are no rotor_speeds";
      case InputStream::kBatteryState:
        return "optional; others, too: docs/messages.md";
      case InputStream::kMotorCommands:
        return "where the actuator is known; others, too: docs/messages.md";
      case InputStream::kTwist:
        return "beside pose: its velocity";
      case InputStream::kTf:
      case InputStream::kStaticTf:
        return "mounts of the sensors; with odometry_tf_child the odometry";
    }
    return "";
  };
  std::vector<odmc::NodeEntry> entries;
  for (const odmc::StreamRole& role : odmc::StreamRoles()) {
    const bool is_tf = odmc::IsTf(role.stream);
    // The node takes tf/tfMessage from bags alone.
    entries.push_back({(is_tf ? "/" : "") + std::string(role.name),
                       is_tf ? std::vector<std::string>{role.types.front()} : role.types,
                       remark(role.stream)});
  }
  return entries;
}

odmc::NodeHelp Help() {
  odmc::NodeHelp help;
  help.name = "estimator_node";
  help.purpose = "estimates the dynamic model of a flying vehicle, live.";
  help.commands = {"rosrun odmc estimator_node _vehicle_file:=VEHICLE.yaml [_KEY:=VALUE ...]",
                   "roslaunch odmc estimator.launch vehicle:=NAME"};
  help.subscribes = Subscribed();
  help.publishes = {
      {"parameters", {"odmc/DynamicParameters"}, "values, sigmas, covariance, trust"},
      {"parameters_accepted", {"odmc/DynamicParameters"}, "latched; for the controller"},
      {"state", {"nav_msgs/Odometry"}, "of the body"},
      {"residual_wrench", {"geometry_msgs/WrenchStamped"}, "force and torque left unexplained"},
      {"phase", {"std_msgs/String"}, "latched; flying, on_ground, in_hand, ..."},
      {"unexplained", {"odmc/UnexplainedResidual"}, "the effect that the model lacks"},
      {"live_image", {"sensor_msgs/Image"}, "parameters and residuals as a picture"},
      {"~displays", {"visualization_msgs/MarkerArray"}, "for RViz"},
      {"~path", {"nav_msgs/Path"}, "for RViz"},
      {"~estimates_plot", {"sensor_msgs/JointState"}, "values and sigmas for plotting tools"},
      {"~plot/*", {"std_msgs/Float64"}, "with plot_topics: a topic for each value and sigma"},
      {"/diagnostics", {"diagnostic_msgs/DiagnosticArray"}, ""},
      {"/tf", {"tf2_msgs/TFMessage"}, "estimated mounts; with body_tf the body"},
  };
  help.services = {
      {"~reset", {"std_srvs/Trigger"}, "forgets the estimate and starts anew"},
      {"~freeze", {"std_srvs/SetBool"}, "stops learning, or goes on"},
      {"~accept", {"std_srvs/Trigger"}, "publishes the estimate as accepted"},
      {"~save", {"std_srvs/Trigger"}, "writes parameters.yaml into output_dir"},
  };
  help.parameters = odmc::DefaultsOf<odmc::EstimatorNodeOptions>();
  help.config_parameter = "config";
  help.config_example = "config/estimator.yaml";
  help.config = odmc::DefaultsOf<odmc::EstimatorOptions>();
  return help;
}

}  // namespace

int main(int argc, char** argv) {
  return odmc::RunNode(argc, argv, Help(),
                       [](const ros::NodeHandle& node, const ros::NodeHandle& private_node) {
                         odmc::EstimatorNode estimator(
                             node, private_node, odmc::ReadEstimatorNodeSetup(node, private_node));
                         ros::spin();
                         if (!estimator.Stop()) throw std::runtime_error("see above");
                       });
}
