#include "odmc/ros/simulator_publisher.h"

#include <diagnostic_msgs/DiagnosticArray.h>
#include <geometry_msgs/Vector3Stamped.h>
#include <rosgraph_msgs/Clock.h>

#include <cmath>
#include <utility>

#include "odmc/ros/control_messages.h"
#include "odmc/ros/conversions.h"

namespace odmc {
namespace {

constexpr double kPathStep_s = 0.05;

bool IsBody(const SensorMount& mount) {
  return mount.p_BS.isZero(0.0) && mount.q_BS.isApprox(Eigen::Quaterniond::Identity(), 0.0);
}

}  // namespace

SimulatorFrames SimulatorFrames::Of(const Vehicle& vehicle, const std::string& world,
                                    const std::string& body) {
  SimulatorFrames frames;
  frames.world = world;
  frames.body = body;
  frames.odometry = IsBody(vehicle.odometry) ? body : "odometry_sensor";
  frames.imu = vehicle.imu ? "imu_link" : body;
  frames.truth = body + "_truth";
  return frames;
}

SimulatorPublisher::SimulatorPublisher(ros::NodeHandle node, SimulatorFrames frames, Stamp epoch,
                                       bool publishes_clock)
    : frames_(std::move(frames)), epoch_(epoch), publishes_clock_(publishes_clock) {
  if (publishes_clock_) clock_ = node.advertise<rosgraph_msgs::Clock>("/clock", 10);
  odometry_ = node.advertise<nav_msgs::Odometry>("odometry", 100);
  imu_ = node.advertise<sensor_msgs::Imu>("imu", 500);
  rotors_ = node.advertise<RotorSpeeds>("rotor_speeds", 500);
  battery_ = node.advertise<sensor_msgs::BatteryState>("battery_state", 10);
  reference_ = node.advertise<FlatOutput>("reference", 10);
  using Points = trajectory_msgs::MultiDOFJointTrajectory;
  point_ = node.advertise<Points>("command_trajectory", 10);
  path_ = node.advertise<Points>("planned_trajectory", 1, true);
  truth_odometry_ = node.advertise<nav_msgs::Odometry>("truth/odometry", 100);
  truth_wrench_ = node.advertise<geometry_msgs::WrenchStamped>("truth/wrench", 100);
  truth_wind_ = node.advertise<geometry_msgs::Vector3Stamped>("truth/wind", 100);
  truth_parameters_ = node.advertise<DynamicParameters>("truth/parameters", 1, true);
  diagnostics_ = node.advertise<diagnostic_msgs::DiagnosticArray>("/diagnostics", 10);
}

void SimulatorPublisher::PublishStart(const Vehicle& vehicle, const DynamicModel& model,
                                      const ModelValues& truth, const Trajectory& trajectory,
                                      double ground_s) {
  truth_parameters_.publish(TruthParameters(model, truth, epoch_, frames_.truth));
  std::vector<geometry_msgs::TransformStamped> mounts;
  const auto add = [&](const std::string& frame, const SensorMount& mount) {
    mounts.push_back(
        ToTransform(epoch_, frames_.body, frame, mount.p_BS, mount.q_BS.toRotationMatrix()));
  };
  if (frames_.odometry != frames_.body) add(frames_.odometry, vehicle.odometry);
  if (vehicle.imu) add(frames_.imu, *vehicle.imu);
  if (!mounts.empty()) static_tf_.sendTransform(mounts);
  if (!std::isfinite(trajectory.end_s())) return;
  std::vector<TimedReference> path;
  for (double t = ground_s; t < trajectory.end_s(); t += kPathStep_s) {
    path.push_back({FromSeconds(t) + epoch_, trajectory.At(t)});
  }
  path_.publish(ToMessage(path, frames_.world, frames_.body));
}

void SimulatorPublisher::PublishClock(Stamp now) {
  if (!publishes_clock_) return;
  rosgraph_msgs::Clock clock;
  clock.clock = ToRos(now + epoch_);
  clock_.publish(clock);
}

void SimulatorPublisher::PublishSamples(const std::vector<Sample>& samples) {
  // The IMU goes last: controllers step when it comes.
  for (const bool imu_turn : {false, true}) {
    for (Sample sample : samples) {
      if (std::holds_alternative<ImuSample>(sample) != imu_turn) continue;
      std::visit([this](auto& s) { s.stamp += epoch_; }, sample);
      if (const auto* odometry = std::get_if<OdometrySample>(&sample)) {
        odometry_.publish(ToMessage(*odometry, frames_.world, frames_.odometry));
      } else if (const auto* imu = std::get_if<ImuSample>(&sample)) {
        imu_.publish(ToMessage(*imu, frames_.imu));
      } else if (const auto* rotors = std::get_if<RotorSample>(&sample)) {
        rotors_.publish(ToMessage(*rotors));
      } else if (const auto* battery = std::get_if<BatterySample>(&sample)) {
        battery_.publish(ToMessage(*battery));
      }
    }
  }
}

void SimulatorPublisher::PublishReference(const FlatReference& reference, Stamp now) {
  reference_.publish(ToMessage(reference, now + epoch_, frames_.world));
}

void SimulatorPublisher::PublishPoint(const FlatReference& reference, Stamp now) {
  point_.publish(ToMessage({{now + epoch_, reference}}, frames_.world, frames_.body));
}

void SimulatorPublisher::PublishTruth(const TruthSample& truth, const Eigen::Vector3d& wind_W,
                                      Stamp now) {
  const Stamp stamp = now + epoch_;
  truth_odometry_.publish(TruthOdometry(truth, stamp, frames_.world, frames_.truth));
  truth_wrench_.publish(TruthWrench(truth, stamp, frames_.truth));
  geometry_msgs::Vector3Stamped wind;
  wind.header = MakeHeader(stamp, frames_.world);
  wind.vector = ToVector3(wind_W);
  truth_wind_.publish(wind);
}

void SimulatorPublisher::PublishTruthTransform(const TruthSample& truth, Stamp now) {
  tf_.sendTransform(ToTransform(now + epoch_, frames_.world, frames_.truth, truth.p_WB,
                                truth.q_WB.toRotationMatrix()));
}

void SimulatorPublisher::PublishDiagnostics(const diagnostic_msgs::DiagnosticStatus& status,
                                            Stamp now) {
  diagnostic_msgs::DiagnosticArray message;
  message.header.stamp = ToRos(now + epoch_);
  message.status.push_back(status);
  diagnostics_.publish(message);
}

}  // namespace odmc
