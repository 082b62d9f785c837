#pragma once

#include <geometry_msgs/Point.h>
#include <geometry_msgs/Pose.h>
#include <geometry_msgs/PoseStamped.h>
#include <geometry_msgs/Quaternion.h>
#include <geometry_msgs/TransformStamped.h>
#include <geometry_msgs/Vector3.h>
#include <nav_msgs/Odometry.h>
#include <ros/time.h>
#include <sensor_msgs/BatteryState.h>
#include <sensor_msgs/Imu.h>
#include <sensor_msgs/JointState.h>
#include <std_msgs/Header.h>

#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "odmc/DynamicParameter.h"
#include "odmc/MotorCommands.h"
#include "odmc/RotorSpeeds.h"
#include "odmc/model/parameter_set.h"
#include "odmc/ros/message_values.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// \file
/// Messages to the core's samples and back. What a message does not say (the frame of its twist,
/// the mount of its sensor) is kept beside the sample until somebody knows.

geometry_msgs::Point ToPoint(const Eigen::Vector3d& p);
geometry_msgs::Quaternion ToQuaternion(const Eigen::Quaterniond& q);
std_msgs::Header MakeHeader(Stamp stamp, const std::string& frame);
DynamicParameter ToMessage(const ParameterEstimate& p);

/// An odometry or pose message. `sample.v_WS` stays empty: its frame is not known yet.
struct OdometryInput {
  OdometrySample sample;
  std::optional<Eigen::Vector3d> linear;  ///< twist as received [m/s]
  std::string frame_id, child_frame_id;
  bool is_pose = false;  ///< came as geometry_msgs/PoseStamped
};

struct ImuInput {
  ImuSample sample;
  std::string frame_id;
};

struct RotorInput {
  RotorSample sample;
  bool rms_only = false;
  bool from_joints = false;  ///< came as sensor_msgs/JointState
};

/// One message of any stream.
using InputSample =
    std::variant<OdometryInput, ImuInput, RotorInput, BatterySample, CommandSample>;

/// Each returns nothing for a message without a stamp, with numbers that are not finite or an
/// attitude that is not unit. Covariances of -1 mark missing parts, as in flight_bag.h.
std::optional<OdometryInput> ToInput(const nav_msgs::Odometry& message);
std::optional<OdometryInput> ToInput(const geometry_msgs::PoseStamped& message);
std::optional<ImuInput> ToInput(const sensor_msgs::Imu& message);
std::optional<BatterySample> ToInput(const sensor_msgs::BatteryState& message);
/// Nothing also where the message has not one speed per rotor. Speeds lose their sign.
std::optional<RotorInput> ToInput(const RotorSpeeds& message, int num_rotors);
/// @param scale takes the joints' velocity to rad/s, see RotorSpeedScale()
std::optional<RotorInput> ToInput(const sensor_msgs::JointState& message, int num_rotors,
                                  double scale);
/// Nothing also where the message has not one throttle per rotor, or one that is no share of full
/// throttle but a pulse width or the like.
std::optional<CommandSample> ToInput(const MotorCommands& message, int num_rotors);

/// Factor that takes a speed in `unit` (rad_s, rpm, erpm) to rad/s.
/// @throws std::invalid_argument for other units or pole pairs below 1
double RotorSpeedScale(const std::string& unit, int pole_pairs);

/// `parent` to `child` with the pose (p, R) of the child in the parent.
geometry_msgs::TransformStamped ToTransform(Stamp stamp, const std::string& parent,
                                            const std::string& child, const Eigen::Vector3d& p,
                                            const Eigen::Matrix3d& R);

}  // namespace odmc
