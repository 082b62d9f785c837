#pragma once

#include <functional>
#include <limits>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace odmc {

// What an Effect may tell of itself to attribution, simulator and reports. Parameters are named by
// their short names, as in ParameterSpec::name.

/// What a flight covers.
struct FlownRange {
  double start_s = 0.0, end_s = 0.0;
  double lowest_m = 0.0;               ///< in the odometry's world
  double height_range_m = 0.0;         ///< from the 5th to the 95th percentile
  double speed_m_s = 0.0;              ///< over ground, 95th percentile
  double descent_m_s = 0.0;            ///< along the body's -z, 95th percentile; at least 0
  std::optional<double> stood_m = {};  ///< height of the odometry on the standing vehicle
};

/// One way to try an effect.
struct EffectTrial {
  std::map<std::string, double> settings = {};  ///< parameters frozen at these values
  /// Where to linearize first, for parameters that do nothing at zero (a place of no mass).
  std::map<std::string, double> start = {};
  /// Own parameters that are estimated then, although the model has them frozen.
  std::vector<std::string> freed = {};
  /// Of `start`, parameters that the regression fits too; the online model then holds them.
  std::vector<std::string> fitted = {};
  /// Between which values parameters are linearized.
  std::map<std::string, std::pair<double, double>> bounds = {};
};

/// How a setting is refined between its grid's values. Exactly one of `ratio` and `step` is set.
struct SettingRefinement {
  std::string parameter;
  double ratio = 0.0;  ///< golden section in the logarithm, this factor to either side
  double step = 0.0;   ///< of the grid; halved as long as it is longer than `least_step`
  double least_step = 0.0;
  double above = -std::numeric_limits<double>::infinity();  ///< settings up to it stay as they are
};

/// What manoeuvre tells an effect from another one.
struct DistinguishingManoeuvre {
  std::string other;
  std::string manoeuvre;
};

/// A quantity that follows from an effect's parameters.
struct DerivedFigure {
  std::string name;
  std::string unit;
  double value = 0.0;
};

/// Where the parameters of a pendulum are among those of an effect, or of a model: length [m],
/// damping ratio, the first of the three of the place where it hangs (from Bo, in B [m]), and the
/// first of the four of its Swing at the start.
struct PendulumParameters {
  int length = 0, damping = 0, place = 0, swing = 0;
};

/// Each call returns the next of a row of standard normal numbers.
using NormalNumbers = std::function<double()>;

}  // namespace odmc
