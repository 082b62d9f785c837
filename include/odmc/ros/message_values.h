#pragma once

#include <geometry_msgs/Point.h>
#include <geometry_msgs/Quaternion.h>
#include <geometry_msgs/Vector3.h>
#include <ros/time.h>
#include <sensor_msgs/JointState.h>
#include <std_msgs/Header.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <string>
#include <vector>

#include "odmc/sensing/samples.h"

namespace odmc {

/// Single values of ROS messages, for bags and nodes alike.

Stamp FromRos(const ros::Time& time);
/// @throws std::invalid_argument if ROS cannot express the stamp
ros::Time ToRos(Stamp stamp);

Eigen::Vector3d ToEigen(const geometry_msgs::Vector3& v);
Eigen::Vector3d ToEigen(const geometry_msgs::Point& p);
Eigen::Quaterniond ToEigen(const geometry_msgs::Quaternion& q);  ///< as it is, not normalised
geometry_msgs::Vector3 ToVector3(const Eigen::Vector3d& v);
geometry_msgs::Point ToPoint(const Eigen::Vector3d& p);
geometry_msgs::Quaternion ToQuaternion(const Eigen::Quaterniond& q);
/// @throws std::invalid_argument as ToRos()
std_msgs::Header MakeHeader(Stamp stamp, const std::string& frame);

/// A speed per joint, in the order of the numbers in their names (rotor_0, rotor_1, ...), whatever
/// the message's order is; in that order where names are missing, have no number, or two the same.
std::vector<double> SpeedsOfJoints(const sensor_msgs::JointState& message);

/// What was measured, from a field of single precision: its shortest decimals, 3.784 V and not
/// 3.78399991989135742.
double FromFloat(float value);

}  // namespace odmc
