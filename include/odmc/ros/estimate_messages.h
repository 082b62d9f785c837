#pragma once

#include <geometry_msgs/WrenchStamped.h>
#include <nav_msgs/Odometry.h>

#include <string>
#include <vector>

#include "odmc/DynamicParameters.h"
#include "odmc/UnexplainedResidual.h"
#include "odmc/attribution/residual_watch.h"
#include "odmc/estimator/estimator.h"

namespace odmc {

/// \file
/// What the estimator found, as messages.

/// False if anything that is published of a snapshot is not a finite number.
bool IsFinite(const Snapshot& snapshot);

/// The estimate as a message; residuals, timing and battery included.
DynamicParameters ToMessage(const DynamicModel& model, const Snapshot& snapshot,
                            const std::string& body_frame);

/// A look at the residual as a message.
/// @param added effects that were added in flight
UnexplainedResidual ToMessage(const ResidualAnalysis& look, const std::string& body_frame,
                              const std::vector<std::string>& added);

/// Pose and twist of the body (not of the sensor), twist in the body frame.
nav_msgs::Odometry BodyOdometry(const Snapshot& snapshot, const std::string& world_frame,
                                const std::string& body_frame);

/// What the model does not explain in the newest interval, in the body frame.
geometry_msgs::WrenchStamped ResidualWrench(const Snapshot& snapshot,
                                            const std::string& body_frame);

}  // namespace odmc
