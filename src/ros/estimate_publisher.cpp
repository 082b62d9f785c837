#include "odmc/ros/estimate_publisher.h"

#include <ros/init.h>
#include <std_msgs/Float64.h>
#include <std_msgs/String.h>

#include <algorithm>

#include "odmc/ros/conversions.h"
#include "odmc/ros/estimate_messages.h"

namespace odmc {
namespace {

constexpr std::chrono::milliseconds kAcceptedPeriod(500);
constexpr std::chrono::seconds kTfPatience(2);
constexpr double kPathSpacing_s = 0.05;
constexpr char kCalibrated[] = "_calibrated";

/// An estimated mount's effect has a parameter that is not frozen.
bool IsEstimated(const DynamicModel& model, const std::string& effect) {
  return std::any_of(model.parameters().begin(), model.parameters().end(),
                     [&](const ModelParameter& p) { return p.effect == effect && p.estimated; });
}

std::string NameOr(const std::string& frame, const char* other) {
  return frame.empty() ? other : frame;
}

}  // namespace

EstimatePublisher::EstimatePublisher(ros::NodeHandle node, ros::NodeHandle private_node,
                                     const EstimatorNodeOptions* options,
                                     const tf2_ros::Buffer* tf_buffer)
    : private_node_(private_node),
      options_(*options),
      tf_buffer_(*tf_buffer),
      parameters_(node.advertise<DynamicParameters>("parameters", 10)),
      accepted_(node.advertise<DynamicParameters>("parameters_accepted", 1, true)),
      state_(node.advertise<nav_msgs::Odometry>("state", 10)),
      wrench_(node.advertise<geometry_msgs::WrenchStamped>("residual_wrench", 10)),
      phase_publisher_(node.advertise<std_msgs::String>("phase", 10, true)),
      displays_(private_node.advertise<visualization_msgs::MarkerArray>("displays", 10)),
      path_publisher_(private_node.advertise<nav_msgs::Path>("path", 10)),
      plot_(private_node.advertise<sensor_msgs::JointState>("estimates_plot", 10)),
      trail_(options->path_length_s, kPathSpacing_s) {}

void EstimatePublisher::Publish(const Snapshot& snapshot, const Context& context) {
  is_published_ = false;
  if (!ros::ok()) return;
  state_.publish(BodyOdometry(snapshot, frames_.odometry, options_.body_frame));
  wrench_.publish(ResidualWrench(snapshot, options_.body_frame));
  trail_.Add(snapshot);
  PublishParameters(snapshot, context);
  PublishBodyTransform(snapshot);
  PublishDisplays(snapshot, context);
}

void EstimatePublisher::PublishParameters(const Snapshot& snapshot, const Context& context,
                                          bool is_news) {
  is_published_ = is_published_ && !is_news;
  const Clock::time_point time = Clock::now();
  const std::chrono::duration<double> period(1.0 / options_.publish_rate_hz);
  const bool is_wanted = !is_published_ || !snapshot.airborne;
  if (!ros::ok() || !is_wanted || time - parameters_published_ < period) return;
  parameters_published_ = time;
  is_published_ = true;
  DynamicParameters message = odmc::ToMessage(*context.model, snapshot, options_.body_frame);
  message.accepted = context.acceptance->accepted();
  message.trust = Name(TrustOf(*context.findings));
  message.trust_reasons = TrustReasons(*context.findings);
  message.phase = phase_;
  parameters_.publish(message);
  PublishPlots(snapshot, *context.model);
  PublishTransforms(snapshot, *context.model);
  if (message.accepted && snapshot.airborne && !context.is_interrupted &&
      time - accepted_published_ >= kAcceptedPeriod) {
    accepted_published_ = time;
    PublishAccepted(snapshot, context);
  }
}

void EstimatePublisher::PublishAccepted(const Snapshot& snapshot, const Context& context) {
  Snapshot usable = context.acceptance->Usable();
  usable.stamp = snapshot.stamp;
  usable.airborne = snapshot.airborne;
  if (!IsFinite(usable)) return;
  DynamicParameters message = odmc::ToMessage(*context.model, usable, options_.body_frame);
  message.accepted = true;
  accepted_.publish(message);
}

void EstimatePublisher::PublishPhase(const std::string& phase) {
  if (phase == phase_ || !ros::ok()) return;
  phase_ = phase;
  std_msgs::String message;
  message.data = phase;
  phase_publisher_.publish(message);
}

void EstimatePublisher::PublishTransforms(const Snapshot& snapshot, const DynamicModel& model) {
  std::vector<geometry_msgs::TransformStamped> transforms;
  if (IsEstimated(model, "odometry_extrinsics")) {
    transforms.push_back(ToTransform(snapshot.stamp, options_.body_frame,
                                     NameOr(frames_.sensor, "odometry") + kCalibrated,
                                     snapshot.body.p_BS, snapshot.body.R_BS));
  }
  if (IsEstimated(model, "imu_extrinsics")) {
    transforms.push_back(ToTransform(snapshot.stamp, options_.body_frame,
                                     NameOr(frames_.imu, "imu") + kCalibrated, snapshot.body.p_BI,
                                     snapshot.body.R_BI));
  }
  if (!transforms.empty()) tf_broadcaster_.sendTransform(transforms);
}

/// RViz refuses a frame without a name, as some odometry has it.
std::string EstimatePublisher::WorldFrame() const { return NameOr(frames_.odometry, "world"); }

void EstimatePublisher::PublishDisplays(const Snapshot& snapshot, const Context& context) {
  const Clock::time_point time = Clock::now();
  const std::chrono::duration<double> period(1.0 / options_.display_rate_hz);
  if (!ros::ok() || time - displayed_ < period) return;
  displayed_ = time;
  if (displays_.getNumSubscribers() > 0) {
    const std::string verdict = !snapshot.airborne               ? ""
                                : context.acceptance->accepted() ? "accepted"
                                                                 : "not accepted";
    displays_.publish(DisplayMarkers(*context.model, snapshot,
                                     {WorldFrame(), options_.body_frame, phase_, verdict}));
  }
  if (path_publisher_.getNumSubscribers() > 0) {
    path_publisher_.publish(trail_.Message(WorldFrame()));
  }
}

// Two publishers of one transform would have the vehicle leap to and fro: where it is left to the
// node, it waits whether somebody else does it.
void EstimatePublisher::PublishBodyTransform(const Snapshot& snapshot) {
  if (options_.body_tf == "never") return;
  if (options_.body_tf == "auto") {
    if (!has_body_tf_ && Clock::now() - started_ > kTfPatience) {
      has_body_tf_ = tf_buffer_.canTransform(WorldFrame(), options_.body_frame, ros::Time(0));
    }
    if (has_body_tf_.value_or(true)) return;
  }
  const nav_msgs::Odometry state = BodyOdometry(snapshot, WorldFrame(), options_.body_frame);
  tf_broadcaster_.sendTransform(ToTransform(
      snapshot.stamp, WorldFrame(), options_.body_frame, ToEigen(state.pose.pose.position),
      ToEigen(state.pose.pose.orientation).toRotationMatrix()));
}

void EstimatePublisher::PublishPlots(const Snapshot& snapshot, const DynamicModel& model) {
  const sensor_msgs::JointState plot = PlottedEstimates(model, snapshot, options_.body_frame);
  plot_.publish(plot);
  if (!options_.plot_topics) return;
  for (size_t i = 0; i < plot.name.size(); ++i) {
    auto& [value, sigma] = plot_topics_[plot.name[i]];
    if (!value) {
      const std::string topic = "plot/" + PlotTopic(plot.name[i]);
      value = private_node_.advertise<std_msgs::Float64>(topic + "/value", 10);
      sigma = private_node_.advertise<std_msgs::Float64>(topic + "/sigma", 10);
    }
    std_msgs::Float64 number;
    number.data = plot.position[i];
    value.publish(number);
    number.data = plot.velocity[i];
    sigma.publish(number);
  }
}

}  // namespace odmc
