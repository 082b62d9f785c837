#include "odmc/trajectory/trajectory.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "odmc/text/format.h"
#include "odmc/text/number_text.h"
#include "odmc/text/refusal.h"
#include "path.h"

namespace odmc {
namespace {

constexpr double kRamp_s = 2.5;       // from rest to full rate along the path, and back to rest
constexpr double kClimb_s = 3.0;      // from the ground to the start
constexpr double kDescent_s = 3.0;    // to the ground, at least
constexpr double kDescent_s_m = 2.0;  // and for each metre of height
constexpr double kSink_s = 1.0;       // from the ground to kSink_m below
constexpr double kSink_m = 0.05;
constexpr double kSettle_s = 1.0;  // from there to standing

bool IsFile(const std::string& name) {
  const std::string ending = ".yaml";
  return name.size() > ending.size() &&
         name.compare(name.size() - ending.size(), ending.size(), ending) == 0;
}

TrajectoryOptions Checked(const TrajectoryOptions& options) {
  std::string error;
  if (!options.IsValid(&error)) throw std::invalid_argument(error);
  return options;
}

TrajectoryOptions ForEver(const std::string& name, double ground_s) {
  TrajectoryOptions options;
  options.name = name;
  options.ground_s = ground_s;
  return options;
}

// How much faster than by itself the path passes.
double RateOf(const TrajectoryOptions& options, const Path& path) {
  constexpr double kTolerance = 1e-3;  // of the plan's own speed
  if (options.top_speed_m_s == 0.0) return 1.0;
  const double own = path.TopSpeed();
  if (own == 0.0) {
    throw std::invalid_argument("the trajectory '" + options.name +
                                "' has no speed, so it cannot have a top_speed_m_s");
  }
  if (IsFile(options.name) && options.top_speed_m_s > own * (1.0 + kTolerance)) {
    throw std::invalid_argument("top_speed_m_s is " + FormatNumber(options.top_speed_m_s) +
                                ", but " + options.name + " and its limits allow " +
                                FormatNumber(own) + " m/s");
  }
  return options.top_speed_m_s / own;
}

// Time along the path at full rate 1: from rest, if it has a duration back to rest.
Derivatives PathTime(double t, double ramp_s, double duration_s) {
  Derivatives phi = {};
  if (ramp_s > 0.0) phi = SmoothStart(t, ramp_s);
  if (ramp_s == 0.0 && t >= 0.0) phi = {t, 1.0, 0.0, 0.0, 0.0};
  if (duration_s == 0.0) return phi;
  return Difference(phi, SmoothStart(t - (duration_s - kRamp_s), kRamp_s));
}

void SetHeight(const Derivatives& z, FlatReference* reference) {
  reference->p_WB.z() = z[0];
  reference->v_WB.z() = z[1];
  reference->a_WB.z() = z[2];
  reference->j_WB.z() = z[3];
  reference->s_WB.z() = z[4];
}

}  // namespace

bool TrajectoryOptions::IsValid(std::string* error) const {
  if (!Trajectory::IsKnown(name)) {
    return Invalid(error, "there is no trajectory '" + name + "'; known are: " +
                              Listed(Trajectory::Names()) + ", or a waypoint file (*.yaml)");
  }
  if (!(ground_s >= 0.0 && std::isfinite(ground_s))) {
    return Invalid(error, "ground_s must be at least 0, not " + FormatNumber(ground_s));
  }
  if (!(top_speed_m_s >= 0.0 && std::isfinite(top_speed_m_s))) {
    return Invalid(error, "top_speed_m_s must be at least 0, not " + FormatNumber(top_speed_m_s));
  }
  if (!(duration_s == 0.0 || (duration_s >= 2.0 * kRamp_s && std::isfinite(duration_s)))) {
    return Invalid(error, "duration_s must be 0 (for ever) or at least " +
                              FormatNumber(2.0 * kRamp_s) +
                              ", the time to start and to stop, not " + FormatNumber(duration_s));
  }
  return true;
}

const std::vector<std::string>& Trajectory::Names() { return PathNames(); }

bool Trajectory::IsKnown(const std::string& name) {
  return IsFile(name) || std::count(Names().begin(), Names().end(), name) > 0;
}

Trajectory::Trajectory(const TrajectoryOptions& options)
    : options_(Checked(options)),
      path_(IsFile(options.name) ? MakeWaypointPath(options.name) : MakePath(options.name)),
      rate_(RateOf(options, *path_)),
      start_s_(options.ground_s > 0.0 ? options.ground_s + kClimb_s : 0.0) {
  if (options.from_origin) offset_.head<2>() = -At(0.0).p_WB.head<2>();
  if (options.ground_s == 0.0) return;
  const double start_z = At(start_s_).p_WB.z();
  if (!(start_z > 0.0)) {
    throw std::invalid_argument("the trajectory '" + options.name + "' starts at a height of " +
                                FormatNumber(start_z) + " m: it cannot take off from the ground");
  }
  if (options.duration_s == 0.0) return;
  const double stop_z = At(start_s_ + options.duration_s).p_WB.z();
  descent_s_ = std::max(kDescent_s, kDescent_s_m * stop_z);
}

Trajectory::Trajectory(const std::string& name, double ground_s)
    : Trajectory(ForEver(name, ground_s)) {}

double Trajectory::ramp_s() const { return path_->needs_ramp() ? kRamp_s : 0.0; }

double Trajectory::end_s() const {
  if (options_.duration_s == 0.0) return std::numeric_limits<double>::infinity();
  const double stop_s = start_s_ + options_.duration_s;
  return descent_s_ == 0.0 ? stop_s : stop_s + descent_s_ + kSink_s + kSettle_s;
}

FlatReference Trajectory::At(double time_s) const {
  const double along_s = time_s - start_s_;
  const Derivatives phi = PathTime(along_s, ramp_s(), options_.duration_s);
  FlatReference reference = path_->At(Scaled(rate_, phi));
  reference.p_WB += offset_;
  const double z = reference.p_WB.z();
  if (start_s_ > 0.0 && along_s < 0.0) {
    SetHeight(Scaled(z, SmoothStep(time_s - options_.ground_s, kClimb_s)), &reference);
    reference.standing = time_s < options_.ground_s;
  }
  const double stopped_s = along_s - options_.duration_s;
  if (descent_s_ > 0.0 && stopped_s > 0.0) {
    const Derivatives left = Difference({1.0}, SmoothStep(stopped_s, descent_s_));
    const Derivatives below = Scaled(kSink_m, SmoothStep(stopped_s - descent_s_, kSink_s));
    SetHeight(Difference(Scaled(z, left), below), &reference);
    reference.standing = time_s >= end_s();
  }
  return reference;
}

}  // namespace odmc
