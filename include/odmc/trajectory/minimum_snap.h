#pragma once

#include <Eigen/Core>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "odmc/trajectory/feasibility.h"
#include "odmc/trajectory/flat_reference.h"

namespace odmc {

/// A place to pass through.
struct Waypoint {
  Eigen::Vector3d p_WB;       ///< [m]
  std::optional<double> yaw;  ///< free where absent [rad]
};

/// True if a path can be laid through `waypoints`: two or more, finite, none within 1 mm of the one
/// before. Otherwise false with a sentence in `error`; waypoints count from 0.
bool AreFlyable(const std::vector<Waypoint>& waypoints, std::string* error);

/// First guess of the time for each segment, from its length alone: a trapezoidal speed profile
/// from rest to rest at the limits' speed and horizontal acceleration.
/// @throws std::invalid_argument as MinimumSnap
std::vector<double> TrapezoidTimes(const std::vector<Waypoint>& waypoints,
                                   const FlightLimits& limits = {}, double gravity = 9.81);

/// Polynomials through waypoints, from rest to rest. D. Mellinger and V. Kumar, "Minimum snap
/// trajectory generation and control for quadrotors", ICRA 2011, section III.
///
/// x, y, z: degree 7, least integral of squared snap; speed, acceleration and jerk vanish at both
/// ends, and everything up to snap is continuous between segments (snap itself steps at the ends).
/// Yaw: degree 5, least integral of squared yaw acceleration; yaw rate and acceleration vanish at
/// both ends and are continuous. Yaws are unwrapped, so each turn takes the short way. Where no
/// waypoint has a yaw it is zero.
///
/// Within one segment time runs from 0 to 1; each of the two quadratic programs is solved through
/// its Karush-Kuhn-Tucker system.
class MinimumSnap {
 public:
  /// Chooses the segment times: TrapezoidTimes(), then descent on the cost at fixed total time
  /// (section III-C), then all of them stretched by one factor, which changes neither the shape
  /// nor the optimality of the path. The factor is the one at which the speed limit is reached,
  /// or, if other limits do not hold there, the least above it found by bisection (to 1e-4) at
  /// which all of them do.
  /// @param gravity [m/s²], > 0
  /// @throws std::invalid_argument for waypoints that are not AreFlyable() or limits that are not
  ///   IsValid(), with their sentence
  explicit MinimumSnap(const std::vector<Waypoint>& waypoints, const FlightLimits& limits = {},
                       double gravity = 9.81);

  /// Takes the segment times as given, whatever that asks of a vehicle.
  /// @param segment_times_s one per segment, > 0
  /// @throws std::invalid_argument also for times that are not positive or not one per segment
  static MinimumSnap WithTimes(const std::vector<Waypoint>& waypoints,
                               const std::vector<double>& segment_times_s);

  /// @param time_s since the start; before 0 and after the end the vehicle rests there [s]
  FlatReference At(double time_s) const;

  double duration_s() const;
  const std::vector<double>& segment_times_s() const;
  /// Integral of squared snap [m²/s⁷].
  double cost() const;

 private:
  class Splines;
  explicit MinimumSnap(const Splines& splines);

  std::shared_ptr<const Splines> splines_;  // never changes, so copies share it
};

}  // namespace odmc
