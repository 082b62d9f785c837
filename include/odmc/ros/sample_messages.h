#pragma once

#include <nav_msgs/Odometry.h>
#include <sensor_msgs/BatteryState.h>
#include <sensor_msgs/Imu.h>

#include <string>

#include "odmc/MotorCommands.h"
#include "odmc/RotorSpeeds.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// \file
/// The core's samples as messages, for bags and nodes alike. What a sample lacks has -1 as its
/// first variance. All throw std::invalid_argument if ROS cannot express the stamp.

/// Twist in the sensor's frame, as nav_msgs/Odometry defines it.
nav_msgs::Odometry ToMessage(const OdometrySample& sample, const std::string& world_frame,
                             const std::string& sensor_frame);
sensor_msgs::Imu ToMessage(const ImuSample& sample, const std::string& imu_frame);
RotorSpeeds ToMessage(const RotorSample& sample, bool rms_only = false);
MotorCommands ToMessage(const CommandSample& sample);
/// What is not known is not a number, as the message asks for.
sensor_msgs::BatteryState ToMessage(const BatterySample& sample);

}  // namespace odmc
