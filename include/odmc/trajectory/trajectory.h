#pragma once

#include <memory>
#include <string>
#include <vector>

#include "odmc/trajectory/flat_reference.h"

namespace odmc {

class Path;

/// What to fly.
struct TrajectoryOptions {
  std::string name = "octo";   ///< one of Trajectory::Names(), or a waypoint file (*.yaml)
  double ground_s = 0.0;       ///< time to stand before take-off; 0 starts in hover [s], >= 0
  double top_speed_m_s = 0.0;  ///< of the path; 0: its own [m/s], >= 0
  bool from_origin = false;    ///< moves the path so that it starts above the origin of W
  double duration_s = 0.0;     ///< of the path, ramps included; 0: for ever [s], else >= 5

  /// Shows every field, by key, to a reader or a printer.
  template <typename Visitor>
  void Visit(Visitor* v) {
    v->Field("name", &name);
    v->Field("ground_s", &ground_s);
    v->Field("top_speed_m_s", &top_speed_m_s);
    v->Field("from_origin", &from_origin);
    v->Field("duration_s", &duration_s);
  }

  /// True if usable; otherwise false with a sentence for the user in `error`. Opens no file.
  bool IsValid(std::string* error) const;
};

/// A reference flight along a named path, entered from hover.
///
/// With time on the ground it stands at z = 0 below the start of the path and climbs to it. Time
/// along the path starts at rest and reaches full rate after ramp_s(); where the path shall end it
/// slows to rest in the same way. So position to snap are smooth from hover to hover. A flight that
/// stood on the ground before lands where it stopped: it descends to z = 0, sinks 5 cm further, so
/// that the vehicle really sits, and stands one second later. Climb and descent are vertical and
/// smooth to jerk; their snap steps, which turns nothing.
///
/// The path of a waypoint file is flown once, as MinimumSnap plans it, and then hovers at its end;
/// it rests at its start by itself and needs no ramp there (its snap steps). `steps` jumps, and its
/// derivatives are zero.
///
/// Vehicles of any size fly the same accelerations (thrust to weight below 3 at the paths' own top
/// speeds).
class Trajectory {
 public:
  /// hover, octo, circle, vertical, yaw, aggressive, vshape, lemniscate, steps.
  static const std::vector<std::string>& Names();

  /// True for one of Names() and for the name of a waypoint file, whether it is there or not.
  static bool IsKnown(const std::string& name);

  /// @throws std::invalid_argument with a sentence for options that are not IsValid(), a waypoint
  ///   file that cannot be flown, a top speed for a path that does not move, or one above what the
  ///   limits of a waypoint file allow
  explicit Trajectory(const TrajectoryOptions& options);

  /// The path `name` at its own speed, for ever.
  /// @param ground_s time to stand at z = 0 before climbing to the start; 0 starts in hover [s]
  explicit Trajectory(const std::string& name, double ground_s = 0.0);

  /// @param time_s since the start of the flight [s]
  FlatReference At(double time_s) const;

  const std::string& name() const { return options_.name; }
  /// Time at which the vehicle hovers at the start of the path [s].
  double start_s() const { return start_s_; }
  /// Time from rest to full rate along the path; 0 for paths that need none [s].
  double ramp_s() const;
  /// Time at which the flight is over: in hover, or standing; infinite where it has no end [s].
  double end_s() const;

 private:
  TrajectoryOptions options_;
  std::shared_ptr<const Path> path_;  // never changes, so copies share it
  double rate_ = 1.0;                 // of the path's own time
  double start_s_;
  Eigen::Vector3d offset_ = Eigen::Vector3d::Zero();  // of the path, horizontal [m]
  double descent_s_ = 0.0;  // from where it stopped to the ground; 0: does not land
};

}  // namespace odmc
