#include "odmc/window/linearisation_error.h"

#include <algorithm>
#include <cmath>

namespace odmc {
namespace {

constexpr double kFirstCurvature = 3.0;   // error in tolerances at a distance of one sigma
constexpr double kLeastCurvature = 0.05;  // a new manoeuvre may bring more than the last sweep saw
constexpr double kCurvatureMemory = 0.5;  // from one sweep to the next
constexpr double kWorthwhile = 0.2;       // of a tolerance, before a sweep is
constexpr double kLeastDistance = 0.1;    // to learn it from [sigmas]

/// How errors of a linearization grow with the distance [sigmas] from its point: as its square, but
/// for small ones, where other errors are larger.
double CurvedDistance(double distance) { return distance * std::max(1.0, distance); }

/// The distance [sigmas] at which they reach `error`, both in tolerances.
double DistanceAt(double error, double curvature) {
  const double curved = error / curvature;
  return curved < 1.0 ? curved : std::sqrt(curved);
}

}  // namespace

double LinearisationError::Distance(const Window& window, const ParameterVector& at) const {
  return (window.eta() - at).cwiseQuotient(sigma).cwiseAbs().maxCoeff();
}

bool LinearisationError::HaveMoved(const Window& window, const ParameterVector& from, double sigmas,
                                   double share) const {
  for (int i = 0; i < from.size(); ++i) {
    const double moved = std::abs(window.eta()[i] - from[i]);
    if (moved > sigmas * sigma[i]) return true;
    if (window.layout().is_log(i) && moved > share) return true;
  }
  return false;
}

bool LinearisationError::IsWorthASweep(const Window& window,
                                       const ParameterVector& begun_at) const {
  const double far =
      std::max(options_->relinearise_parameters, DistanceAt(kWorthwhile, curvature_));
  return HaveMoved(window, begun_at, far, options_->relinearise_share);
}

bool LinearisationError::MayCost(double error, const Window& window) const {
  return HaveMoved(window, in_use_at_, DistanceAt(error, curvature_), options_->relinearise_share);
}

void LinearisationError::ForgetCurvature() { curvature_ = kFirstCurvature; }

void LinearisationError::ExpectNoLess() { curvature_ = std::max(curvature_, kFirstCurvature); }

void LinearisationError::LearnFrom(const RootTriangle& root, const ParameterVector& begun_at) {
  if (!SigmaOf(root, &after_)) return;
  const double distance = (begun_at - in_use_at_).cwiseQuotient(after_).cwiseAbs().maxCoeff();
  if (distance < kLeastDistance) return;
  const double change = (before_.cwiseQuotient(after_).array() - 1.0).abs().maxCoeff();
  const double measured = change / options_->sigma_tolerance;
  curvature_ = std::max(
      {measured / CurvedDistance(distance), kCurvatureMemory * curvature_, kLeastCurvature});
}

bool LinearisationError::SigmaOf(const RootTriangle& root, Eigen::VectorXd* of_root) {
  if (!root.Covariance(&covariance_)) return false;
  *of_root = covariance_.diagonal().cwiseSqrt();
  return true;
}

}  // namespace odmc
