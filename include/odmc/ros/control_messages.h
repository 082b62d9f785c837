#pragma once

#include <geometry_msgs/WrenchStamped.h>
#include <nav_msgs/Odometry.h>
#include <trajectory_msgs/MultiDOFJointTrajectory.h>

#include <optional>
#include <string>
#include <vector>

#include "odmc/DynamicParameters.h"
#include "odmc/FlatOutput.h"
#include "odmc/MotorCommands.h"
#include "odmc/RateThrust.h"
#include "odmc/RotorSpeeds.h"
#include "odmc/control/flatness_controller.h"
#include "odmc/model/parameter_set.h"
#include "odmc/ros/reference_intake.h"
#include "odmc/ros/sample_messages.h"
#include "odmc/sensing/samples.h"
#include "odmc/sim/truth_sample.h"

namespace odmc {

/// \file
/// Messages of controller and simulator to the core's structs and back.

// ---- To the core -------------------------------------------------------------------------------

/// Nothing for a message without a stamp or with numbers that are not finite.
std::optional<TimedReference> ToReference(const FlatOutput& message);

/// Points of the first joint; a header without stamp means `now`. A single point may leave out
/// velocity and acceleration (rest), of several each must have a velocity. Yaw is that of the
/// shortest tilt's decomposition (trajectory/flatness.h), unwrapped from point to point.
/// @param error a sentence where nothing is returned
std::optional<std::vector<TimedReference>> ToReferences(
    const trajectory_msgs::MultiDOFJointTrajectory& message, Stamp now, std::string* error);

/// Nothing for a message without a stamp or with numbers that are not finite.
std::optional<ParameterSet> ToParameterSet(const DynamicParameters& message);

/// Why a controller of `vehicle` must not take an estimate; empty if it may. One without a word
/// about its trust comes from an older sender.
std::string ObjectionTo(const DynamicParameters& message, const std::string& vehicle);

// ---- From the core -----------------------------------------------------------------------------

FlatOutput ToMessage(const FlatReference& reference, Stamp stamp, const std::string& world_frame);

/// Orientations are those of hover under each point's yaw.
trajectory_msgs::MultiDOFJointTrajectory ToMessage(const std::vector<TimedReference>& points,
                                                   const std::string& world_frame,
                                                   const std::string& body_frame);

RotorSpeeds RotorCommand(const ControlCommand& command);
/// @pre the command has throttles
MotorCommands MotorCommand(const ControlCommand& command);
RateThrust RateThrustCommand(const ControlCommand& command, const std::string& body_frame);
/// False if anything that is published of a command is not a finite number.
bool IsFinite(const ControlCommand& command);

/// Pose and twist of the body, twist in the body frame.
nav_msgs::Odometry TruthOdometry(const TruthSample& truth, Stamp stamp,
                                 const std::string& world_frame, const std::string& body_frame);
/// All forces but gravity, and their torque about the centre of mass, in the body frame.
geometry_msgs::WrenchStamped TruthWrench(const TruthSample& truth, Stamp stamp,
                                         const std::string& body_frame);
/// Known exactly: every sigma is 0.
DynamicParameters TruthParameters(const DynamicModel& model, const ModelValues& values, Stamp stamp,
                                  const std::string& body_frame);

}  // namespace odmc
