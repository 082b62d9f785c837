#pragma once

#include <memory>
#include <string>
#include <vector>

#include "odmc/trajectory/flat_reference.h"
#include "path_time.h"

namespace odmc {

/// A path that is a function of a time of its own.
class Path {
 public:
  virtual ~Path() = default;

  /// Where the vehicle shall be, with derivatives by t, when the path's own time passes as phi(t).
  virtual FlatReference At(const Derivatives& phi) const = 0;

  /// Own time in which the path shows its top speed.
  virtual double span_s() const = 0;

  /// False where the path's own time may start at full rate: it rests at its start, or jumps.
  virtual bool needs_ramp() const { return true; }

  /// Largest speed within span_s(), at full rate [m/s].
  double TopSpeed() const;
};

/// Names of the paths that need no file.
const std::vector<std::string>& PathNames();

/// The path of a name in PathNames().
/// @throws std::out_of_range for another name
std::shared_ptr<const Path> MakePath(const std::string& name);

/// Minimum snap through the waypoints of a file, once, planned with a gravity of 9.81 m/s².
/// @throws std::invalid_argument with a sentence that names the file
std::shared_ptr<const Path> MakeWaypointPath(const std::string& file);

}  // namespace odmc
