#pragma once

#include <geometry_msgs/Point.h>
#include <geometry_msgs/Pose.h>
#include <geometry_msgs/Quaternion.h>
#include <geometry_msgs/TransformStamped.h>
#include <geometry_msgs/Vector3.h>
#include <nav_msgs/Odometry.h>
#include <ros/time.h>
#include <sensor_msgs/BatteryState.h>
#include <sensor_msgs/Imu.h>
#include <std_msgs/Header.h>

#include <optional>
#include <string>

#include "odmc/DynamicParameter.h"
#include "odmc/model/parameter_set.h"
#include "odmc/ros/message_values.h"
#include "odmc/ros/streams.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// \file
/// Messages to the core's samples and back.

DynamicParameter ToMessage(const ParameterEstimate& p);

/// The input if a sensor can have measured it, its attitude made unit, its rotor speeds without
/// their sign; nothing where it has no stamp, numbers that are not finite, an attitude that is not
/// unit, or a throttle that is no share of full throttle but a pulse width or the like.
std::optional<InputSample> AcceptedInput(InputSample input);

/// Messages to accepted inputs.
std::optional<OdometryInput> ToInput(const nav_msgs::Odometry& message);
std::optional<ImuInput> ToInput(const sensor_msgs::Imu& message);
std::optional<BatterySample> ToInput(const sensor_msgs::BatteryState& message);
/// Nothing also where the message has not one speed per rotor. Speeds lose their sign.
std::optional<RotorInput> ToInput(const RotorSpeeds& message, int num_rotors);
/// Nothing also where the message has not one throttle per rotor.
std::optional<CommandSample> ToInput(const MotorCommands& message, int num_rotors);

/// `parent` to `child` with the pose (p, R) of the child in the parent.
geometry_msgs::TransformStamped ToTransform(Stamp stamp, const std::string& parent,
                                            const std::string& child, const Eigen::Vector3d& p,
                                            const Eigen::Matrix3d& R);

}  // namespace odmc
