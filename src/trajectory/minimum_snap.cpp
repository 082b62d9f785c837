#include "odmc/trajectory/minimum_snap.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>

#include "odmc/text/number_text.h"
#include "smooth_spline.h"

namespace odmc {
namespace {

constexpr double kSamePlace_m = 1e-3;
constexpr double kTwoPi = 6.283185307179586;
constexpr SplineKind kSnapKind = {7, 4, 3, 4};
constexpr SplineKind kYawKind = {5, 2, 2, 2};

using Knots = std::vector<std::optional<SmoothSpline::Values>>;

void Check(const std::vector<Waypoint>& waypoints) {
  std::string error;
  if (!AreFlyable(waypoints, &error)) throw std::invalid_argument(error);
}

void Check(const FlightLimits& limits, double gravity) {
  std::string error;
  if (!limits.IsValid(&error)) throw std::invalid_argument(error);
  if (!(std::isfinite(gravity) && gravity > 0.0)) {
    throw std::invalid_argument("gravity must be positive, not " + FormatNumber(gravity));
  }
}

void Check(const std::vector<double>& times_s, size_t num_waypoints) {
  if (times_s.size() + 1 != num_waypoints) {
    throw std::invalid_argument(std::to_string(num_waypoints) + " waypoints need " +
                                std::to_string(num_waypoints - 1) + " segment times, not " +
                                std::to_string(times_s.size()));
  }
  for (size_t i = 0; i < times_s.size(); ++i) {
    if (std::isfinite(times_s[i]) && times_s[i] > 0.0) continue;
    throw std::invalid_argument("segment_times_s[" + std::to_string(i) +
                                "] must be positive, not " + FormatNumber(times_s[i]));
  }
}

SmoothSpline PositionSpline(const std::vector<Waypoint>& waypoints,
                            const std::vector<double>& times_s) {
  Knots knots;
  for (const Waypoint& waypoint : waypoints) knots.push_back(waypoint.p_WB.transpose());
  return SmoothSpline(kSnapKind, times_s, knots);
}

// Yaws of the waypoints that have one, each within half a turn of the one before.
Knots UnwrappedYaws(const std::vector<Waypoint>& waypoints) {
  Knots knots;
  std::optional<double> last;
  for (const Waypoint& waypoint : waypoints) {
    knots.emplace_back();
    if (!waypoint.yaw) continue;
    if (last) last = *last + std::remainder(*waypoint.yaw - *last, kTwoPi);
    if (!last) last = waypoint.yaw;
    knots.back() = SmoothSpline::Values::Constant(1, *last);
  }
  if (!last) knots.front() = SmoothSpline::Values::Zero(1);
  return knots;
}

// Slope of the logarithm of the cost by the logarithms of the segment times, along those that keep
// the total time.
Eigen::ArrayXd LogarithmicSlope(const SmoothSpline& spline) {
  const std::vector<double> slopes = spline.SnapCostSlopes();
  const Eigen::Map<const Eigen::ArrayXd> g(slopes.data(), slopes.size());
  const Eigen::Map<const Eigen::ArrayXd> T(spline.times_s().data(), slopes.size());
  return T * (g - (g * T).sum() / T.sum()) / spline.Cost();
}

// Every time multiplied by exp(step * direction), then all of them such that the sum is kept.
std::vector<double> Moved(const std::vector<double>& times_s, const Eigen::ArrayXd& direction,
                          double step) {
  const Eigen::Map<const Eigen::ArrayXd> T(times_s.data(), times_s.size());
  Eigen::ArrayXd moved = T * (step * direction).exp();
  moved *= T.sum() / moved.sum();
  return {moved.data(), moved.data() + moved.size()};
}

// Descends on the cost over the segment times at their total, with a step that grows while it
// succeeds and shrinks where it does not (Armijo's rule).
SmoothSpline WithBestTimes(const std::vector<Waypoint>& waypoints,
                           const std::vector<double>& first_s) {
  constexpr int kMaxIterations = 200;
  constexpr double kFlat = 1e-3;      // slope at which the cost counts as least
  constexpr double kSmallest = 1e-9;  // step that counts as none
  constexpr double kMaxChange = 0.5;  // of the logarithm of a time, in one step
  SmoothSpline best = PositionSpline(waypoints, first_s);
  double step = 0.02;
  for (int i = 0; i < kMaxIterations; ++i) {
    const Eigen::ArrayXd slope = LogarithmicSlope(best);
    if (slope.matrix().norm() < kFlat || step < kSmallest) break;
    step = std::min(step, kMaxChange / slope.abs().maxCoeff());
    SmoothSpline next = PositionSpline(waypoints, Moved(best.times_s(), -slope, step));
    const bool better =
        std::log(next.Cost() / best.Cost()) < -0.1 * step * slope.matrix().squaredNorm();
    if (better) best = std::move(next);
    step *= better ? 1.5 : 0.5;
  }
  return best;
}

}  // namespace

bool AreFlyable(const std::vector<Waypoint>& waypoints, std::string* error) {
  if (waypoints.size() < 2) {
    *error = "a path needs at least two waypoints, not " + std::to_string(waypoints.size());
    return false;
  }
  for (size_t i = 0; i < waypoints.size(); ++i) {
    const std::string name = "waypoints[" + std::to_string(i) + "]";
    if (!waypoints[i].p_WB.allFinite() || !std::isfinite(waypoints[i].yaw.value_or(0.0))) {
      *error = name + " has a number that is not finite";
      return false;
    }
    if (i > 0 && (waypoints[i].p_WB - waypoints[i - 1].p_WB).norm() < kSamePlace_m) {
      *error = name + " is at the same place as waypoints[" + std::to_string(i - 1) + "]";
      return false;
    }
  }
  return true;
}

std::vector<double> TrapezoidTimes(const std::vector<Waypoint>& waypoints,
                                   const FlightLimits& limits, double gravity) {
  Check(waypoints);
  Check(limits, gravity);
  const double v = limits.max_speed_m_s;
  const double a = gravity * std::sqrt(std::pow(limits.max_thrust_over_weight, 2) - 1.0);
  std::vector<double> times_s;
  for (size_t i = 1; i < waypoints.size(); ++i) {
    const double length = (waypoints[i].p_WB - waypoints[i - 1].p_WB).norm();
    const bool cruises = length > v * v / a;
    times_s.push_back(cruises ? length / v + v / a : 2.0 * std::sqrt(length / a));
  }
  return times_s;
}

/// Position and yaw on the same segments.
class MinimumSnap::Splines {
 public:
  Splines(const std::vector<Waypoint>& waypoints, const SmoothSpline& position)
      : position_(position), yaw_(kYawKind, position.times_s(), UnwrappedYaws(waypoints)) {}

  const SmoothSpline& position() const { return position_; }

  Splines Stretched(double factor) const {
    return Splines(position_.Stretched(factor), yaw_.Stretched(factor));
  }

  FlatReference At(double time_s) const {
    FlatReference reference;
    reference.p_WB = position_.Derivative(time_s, 0).transpose();
    reference.yaw = yaw_.Derivative(time_s, 0)[0];
    if (time_s < 0.0 || time_s > position_.duration_s()) return reference;
    reference.v_WB = position_.Derivative(time_s, 1).transpose();
    reference.a_WB = position_.Derivative(time_s, 2).transpose();
    reference.j_WB = position_.Derivative(time_s, 3).transpose();
    reference.s_WB = position_.Derivative(time_s, 4).transpose();
    reference.d_yaw = yaw_.Derivative(time_s, 1)[0];
    reference.dd_yaw = yaw_.Derivative(time_s, 2)[0];
    return reference;
  }

  Feasibility Asked(const FlightLimits& limits, double gravity) const {
    const auto at = [this](double time_s) { return At(time_s); };
    return CheckFeasibility(at, 0.0, position_.duration_s(), limits, gravity);
  }

  // Stretched or shortened such that it just meets its limits.
  Splines Fitted(const FlightLimits& limits, double gravity) const {
    constexpr double kTolerance = 1e-4;
    const double speed = Asked(limits, gravity).max_speed_m_s;
    const double shortest = speed / limits.max_speed_m_s;
    const auto holds = [&](double factor) { return Stretched(factor).Asked(limits, gravity).ok(); };
    if (holds(shortest)) return Stretched(shortest);
    double fast = shortest, slow = 2.0 * shortest;
    for (; !holds(slow); slow *= 2.0) fast = slow;
    while (slow > fast * (1.0 + kTolerance)) {
      const double middle = 0.5 * (fast + slow);
      (holds(middle) ? slow : fast) = middle;
    }
    return Stretched(slow);
  }

 private:
  Splines(SmoothSpline position, SmoothSpline yaw)
      : position_(std::move(position)), yaw_(std::move(yaw)) {}

  SmoothSpline position_;
  SmoothSpline yaw_;
};

MinimumSnap::MinimumSnap(const std::vector<Waypoint>& waypoints, const FlightLimits& limits,
                         double gravity) {
  const std::vector<double> first_s = TrapezoidTimes(waypoints, limits, gravity);
  const Splines best(waypoints, WithBestTimes(waypoints, first_s));
  splines_ = std::make_shared<const Splines>(best.Fitted(limits, gravity));
}

MinimumSnap::MinimumSnap(const Splines& splines)
    : splines_(std::make_shared<const Splines>(splines)) {}

MinimumSnap MinimumSnap::WithTimes(const std::vector<Waypoint>& waypoints,
                                   const std::vector<double>& segment_times_s) {
  Check(waypoints);
  Check(segment_times_s, waypoints.size());
  return MinimumSnap(Splines(waypoints, PositionSpline(waypoints, segment_times_s)));
}

FlatReference MinimumSnap::At(double time_s) const { return splines_->At(time_s); }

double MinimumSnap::duration_s() const { return splines_->position().duration_s(); }

const std::vector<double>& MinimumSnap::segment_times_s() const {
  return splines_->position().times_s();
}

double MinimumSnap::cost() const { return splines_->position().Cost(); }

}  // namespace odmc
