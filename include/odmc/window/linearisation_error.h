#pragma once

#include <Eigen/Core>

#include "odmc/window/incremental_options.h"
#include "odmc/window/root_triangle.h"
#include "odmc/window/window.h"

namespace odmc {

/// How far parameters are from where they were linearized, in their sigmas, and what that may cost.
/// Every sweep solves the same data at two points and shows how much the distance between them
/// mattered.
class LinearisationError {
 public:
  /// @param options must outlive it
  explicit LinearisationError(const IncrementalOptions* options) : options_(options) {}

  Eigen::VectorXd sigma;  ///< of the parameters, last known (n)

  /// The largest distance of a parameter from `at` [sigmas].
  double Distance(const Window& window, const ParameterVector& at) const;
  /// True if one is further than `sigmas` from there, or, in logarithms, than `share`.
  bool HaveMoved(const Window& window, const ParameterVector& from, double sigmas,
                 double share) const;
  /// True if they are far enough from where a sweep began for another one to be worthwhile.
  bool IsWorthASweep(const Window& window, const ParameterVector& begun_at) const;
  /// True if putting the relinearization off might cost more than `error` tolerances.
  bool MayCost(double error, const Window& window) const;

  /// The chain in use is linearized at `at`.
  void SetInUse(const ParameterVector& at) { in_use_at_ = at; }
  const ParameterVector& in_use_at() const { return in_use_at_; }
  /// Error in tolerances at a distance of one sigma.
  double curvature() const { return curvature_; }
  void SetCurvature(double curvature) { curvature_ = curvature; }
  /// Back to what is assumed of a new problem.
  void ForgetCurvature();
  /// Assumes no less than of a new problem.
  void ExpectNoLess();

  /// A sweep is about to take the place of the chain with this root.
  /// @returns false if it has no covariance
  bool SeeBefore(const RootTriangle& root) { return SigmaOf(root, &before_); }
  /// It has; it began with parameters at `begun_at`. What the new linearization of the same data
  /// changed tells how far the next may be put off.
  void LearnFrom(const RootTriangle& root, const ParameterVector& begun_at);

 private:
  bool SigmaOf(const RootTriangle& root, Eigen::VectorXd* of_root);

  const IncrementalOptions* options_;
  ParameterVector in_use_at_;       // the sweep brings it on
  Eigen::VectorXd before_, after_;  // sigmas, as a sweep takes the chain's place
  Eigen::MatrixXd covariance_;
  double curvature_ = 0.0;
};

}  // namespace odmc
