#pragma once

#include <nav_msgs/Path.h>
#include <sensor_msgs/JointState.h>
#include <visualization_msgs/MarkerArray.h>

#include <string>
#include <utility>
#include <vector>

#include "odmc/estimator/estimator.h"

namespace odmc {

/// \file
/// The estimate for RViz and plotting tools (docs/watching.md). No number that leaves here is NaN
/// or infinite: what is not finite is left out.

/// What of the node a display says besides the estimate.
struct DisplayScene {
  std::string world_frame, body_frame;
  std::string phase;    ///< of the flight, Name(FlightPhase)
  std::string verdict;  ///< beside the phase, as "accepted"; may be empty
};

/// Markers of an estimate, each with its own namespace, always the same ones (DELETE where there is
/// nothing to show):
///
///   vehicle            arms and rotor discs, red where clockwise from above     body frame
///   centre_of_gravity  sphere at Bcm                                            body frame
///   residual_force     arrow from Bcm, an arm's length for 1/20 of the weight   body frame
///   residual_torque    arrow from Bcm, likewise for 1/1000 of weight times arm   body frame
///   velocity           arrow from Bo, where the body will be in 0.1 s           world frame
///   wind               arrow that ends above Bo, likewise                       world frame
///   phase              text above Bo                                            world frame
///
/// All are stamped as the snapshot.
visualization_msgs::MarkerArray DisplayMarkers(const DynamicModel& model, const Snapshot& snapshot,
                                               const DisplayScene& scene);

/// Parameters as plotting tools read them without our messages: `name` full names, `position`
/// values, `velocity` sigmas (0 where frozen), both in the parameter's unit, `effort` 1 where the
/// flight shows the parameter, else 0.
sensor_msgs::JointState PlottedEstimates(const DynamicModel& model, const Snapshot& snapshot,
                                         const std::string& body_frame);

/// Topic below ~plot for a parameter: thrust.k_f becomes thrust/k_f; what no ROS name may have
/// becomes an underscore.
std::string PlotTopic(const std::string& full_name);

/// Where the body was, for nav_msgs/Path. Thread-compatible.
class PathTrail {
 public:
  /// @param length_s  time looked back [s], > 0
  /// @param spacing_s  between poses [s], > 0: what comes sooner is left out
  PathTrail(double length_s, double spacing_s) : length_s_(length_s), spacing_s_(spacing_s) {}

  /// Adds the body's pose. A clock that steps back begins a new path.
  void Add(const Snapshot& snapshot);
  void Clear() { poses_.clear(); }

  /// The path as of its newest pose, in the world frame.
  nav_msgs::Path Message(const std::string& world_frame) const;

 private:
  const double length_s_, spacing_s_;
  std::vector<std::pair<Stamp, geometry_msgs::Pose>> poses_;
};

}  // namespace odmc
