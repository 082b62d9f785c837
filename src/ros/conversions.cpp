#include "odmc/ros/conversions.h"

#include <cmath>
#include <stdexcept>
#include <string>
#include <vector>

#include "odmc/sensing/plausible.h"

namespace odmc {
namespace {

constexpr double kMissing = -1.0;                             // as a first variance
constexpr double kLeastThrottle = -0.2, kMostThrottle = 1.2;  // ESCs may be told 800 to 2200 us

/// Pose with its stamp; nothing if it is not sound.
std::optional<OdometryInput> PoseInput(const std_msgs::Header& header,
                                       const geometry_msgs::Pose& pose) {
  OdometryInput input;
  input.sample.stamp = FromRos(header.stamp);
  input.sample.p_WS = ToEigen(pose.position);
  input.sample.q_WS = ToEigen(pose.orientation);
  input.frame_id = header.frame_id;
  if (input.sample.stamp <= 0 || !IsPlausible(input.sample)) return std::nullopt;
  input.sample.q_WS.normalize();
  return input;
}

std::optional<RotorInput> SpeedInput(const std_msgs::Header& header,
                                     const std::vector<double>& speeds, int num_rotors,
                                     double scale) {
  if (static_cast<int>(speeds.size()) != num_rotors) return std::nullopt;
  RotorInput input;
  input.sample.stamp = FromRos(header.stamp);
  input.sample.speed =
      scale * Eigen::Map<const Eigen::VectorXd>(speeds.data(), num_rotors).cwiseAbs();
  if (input.sample.stamp <= 0 || !IsPlausible(input.sample)) return std::nullopt;
  return input;
}

}  // namespace

geometry_msgs::Point ToPoint(const Eigen::Vector3d& p) {
  geometry_msgs::Point m;
  m.x = p.x();
  m.y = p.y();
  m.z = p.z();
  return m;
}

geometry_msgs::Quaternion ToQuaternion(const Eigen::Quaterniond& q) {
  geometry_msgs::Quaternion m;
  m.x = q.x();
  m.y = q.y();
  m.z = q.z();
  m.w = q.w();
  return m;
}

std_msgs::Header MakeHeader(Stamp stamp, const std::string& frame) {
  std_msgs::Header header;
  header.stamp = ToRos(stamp);
  header.frame_id = frame;
  return header;
}

DynamicParameter ToMessage(const ParameterEstimate& p) {
  DynamicParameter m;
  m.name = p.full_name;
  m.value = p.value;
  m.sigma = p.sigma;
  m.unit = p.unit;
  m.state = p.estimated ? DynamicParameter::ESTIMATED : DynamicParameter::FROZEN;
  m.observable = p.observable;
  return m;
}

// ---- Messages to samples -----------------------------------------------------------------------

std::optional<OdometryInput> ToInput(const nav_msgs::Odometry& message) {
  std::optional<OdometryInput> input = PoseInput(message.header, message.pose.pose);
  if (!input) return std::nullopt;
  input->child_frame_id = message.child_frame_id;
  if (message.twist.covariance[0] != kMissing) input->linear = ToEigen(message.twist.twist.linear);
  if (message.twist.covariance[21] != kMissing) {
    input->sample.w_WS_S = ToEigen(message.twist.twist.angular);
  }
  OdometrySample moving = input->sample;
  moving.v_WS = input->linear;  // in whichever frame
  if (!IsPlausible(moving)) return std::nullopt;
  return input;
}

std::optional<OdometryInput> ToInput(const geometry_msgs::PoseStamped& message) {
  std::optional<OdometryInput> input = PoseInput(message.header, message.pose);
  if (input) input->is_pose = true;
  return input;
}

std::optional<ImuInput> ToInput(const sensor_msgs::Imu& message) {
  ImuInput input;
  input.sample.stamp = FromRos(message.header.stamp);
  input.frame_id = message.header.frame_id;
  if (message.angular_velocity_covariance[0] != kMissing) {
    input.sample.gyro_I = ToEigen(message.angular_velocity);
  }
  if (message.linear_acceleration_covariance[0] != kMissing) {
    input.sample.specific_force_I = ToEigen(message.linear_acceleration);
  }
  const bool has_any = input.sample.gyro_I || input.sample.specific_force_I;
  if (input.sample.stamp <= 0 || !has_any || !IsPlausible(input.sample)) return std::nullopt;
  return input;
}

std::optional<BatterySample> ToInput(const sensor_msgs::BatteryState& message) {
  const BatterySample sample{FromRos(message.header.stamp), FromFloat(message.voltage)};
  if (sample.stamp <= 0 || !std::isfinite(sample.voltage_V)) return std::nullopt;
  return sample;
}

std::optional<RotorInput> ToInput(const RotorSpeeds& message, int num_rotors) {
  std::optional<RotorInput> input =
      SpeedInput(message.header, message.angular_velocity_rad_s, num_rotors, 1.0);
  if (input) input->rms_only = message.rms_only;
  return input;
}

std::optional<RotorInput> ToInput(const sensor_msgs::JointState& message, int num_rotors,
                                  double scale) {
  std::optional<RotorInput> input =
      SpeedInput(message.header, SpeedsOfJoints(message), num_rotors, scale);
  if (input) input->from_joints = true;
  return input;
}

std::optional<CommandSample> ToInput(const MotorCommands& message, int num_rotors) {
  if (static_cast<int>(message.throttle.size()) != num_rotors) return std::nullopt;
  CommandSample sample;
  sample.stamp = FromRos(message.header.stamp);
  sample.throttle = Eigen::Map<const Eigen::VectorXd>(message.throttle.data(), num_rotors);
  if (sample.stamp <= 0 || !sample.throttle.allFinite()) return std::nullopt;
  if (sample.throttle.minCoeff() < kLeastThrottle || sample.throttle.maxCoeff() > kMostThrottle) {
    return std::nullopt;
  }
  return sample;
}

double RotorSpeedScale(const std::string& unit, int pole_pairs) {
  const double rpm = M_PI / 30.0;
  if (unit == "rad_s") return 1.0;
  if (unit == "rpm") return rpm;
  if (unit != "erpm") {
    throw std::invalid_argument("rotor_speed_unit must be rad_s, rpm or erpm, not '" + unit + "'");
  }
  if (pole_pairs < 1) {
    throw std::invalid_argument("pole_pairs must be at least 1, not " + std::to_string(pole_pairs));
  }
  return rpm / pole_pairs;
}

geometry_msgs::TransformStamped ToTransform(Stamp stamp, const std::string& parent,
                                            const std::string& child, const Eigen::Vector3d& p,
                                            const Eigen::Matrix3d& R) {
  geometry_msgs::TransformStamped m;
  m.header = MakeHeader(stamp, parent);
  m.child_frame_id = child;
  m.transform.translation = ToVector3(p);
  m.transform.rotation = ToQuaternion(Eigen::Quaterniond(R).normalized());
  return m;
}

}  // namespace odmc
