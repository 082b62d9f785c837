#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <array>
#include <vector>

#include "odmc/estimator/noise_estimation.h"
#include "odmc/factors/dynamics_factor.h"
#include "odmc/window/window.h"
#include "odmc/window/window_solver.h"

namespace odmc {

/// How much of the information about the parameters is feigned by noise of the states.
///
/// What a factor says of a parameter goes with the square of its Jacobian, which is taken at the
/// estimated states. Their errors enlarge that square: in hover, where rates and velocities are
/// hardly more than noise, JᵀJ says that drag and viscous torque were seen, and a residual cannot
/// follow them. With e the states' error, the mean of what it adds is the sum over the columns l of
/// a square root of its covariance of (J(x + l) - J(x))ᵀ (J(x + l) - J(x)). That is measured at one
/// interval now and then and counted for all; what remains of the information without it is what
/// the flight really shows.
///
/// A second error comes with it. Of all ways of the states the estimate takes the likeliest,
/// without the volume they fill: the density of a state given the one before has, in Form M, the
/// factor det(1 - Δt/2 ∂ẋ/∂x), which favours damping and is left out of the sum of squares. Its
/// logarithm is -½ T div ẋ over a flight of T (the Onsager-Machlup term); so the estimate is off by
/// about the covariance times ½ T ∂(div ẋ)/∂η. That is little where the flight shows much, and 0.01
/// N m s of viscous torque in half a minute of hover. Putting the term into the estimate would need
/// noise levels that are right for the flight at hand (too high ones ask for more and more
/// damping), so it is in the sigma.
///
/// It comes from what drives the states at random from interval to interval; what raises the noise
/// level above its least is what the model lacks, which is smooth, and does not count for it.
///
/// Changes published sigmas alone, no estimate.
class RegressorNoise {
 public:
  explicit RegressorNoise(int num_parameters);

  /// True when Look() is due at this flight time: every second, later every tenth of the flight.
  bool IsDue(double flown_s) const { return flown_s >= next_s_; }

  /// Measures it at the newest interval and counts it for the time since the last look.
  /// @param covariance of the newest state's tangent (12×12)
  /// @param levels of what is not modelled, in use
  void Look(const Window& window, const DynamicModel& model,
            const ProcessNoiseEstimator::Levels& levels,
            const WindowSolver::StateMatrix& covariance, double flown_s);

  /// Scales the information counted by what RescalePrior() returns: another noise level.
  void Rescale(const Eigen::MatrixXd& root);

  /// The same for all that was counted: less is known than before.
  void Forget(const Eigen::MatrixXd& root);

  /// Factor on each parameter's standard deviation (n), >= 1, up to that of its prior.
  /// @param covariance of the parameters (n×n); @param prior_sigma (n)
  const Eigen::VectorXd& Inflation(const Eigen::MatrixXd& covariance,
                                   const Eigen::VectorXd& prior_sigma);

 private:
  /// Of bounded size, so that its decomposition takes nothing from the heap.
  using Square = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMaxModelParameters,
                               kMaxModelParameters>;

  bool ParameterJacobian(const Window& window, const Factor& factor,
                         const std::array<double, kStateSize>& x0,
                         const std::array<double, kStateSize>& x1);

  void AddPull(const DynamicsMeasurement& measurement, const Window& window, const Keyframe& from,
               const Keyframe& to, const DynamicModel& model,
               const ProcessNoiseEstimator::Levels& levels, double flown_s);

  int n_;
  double counted_s_ = 0.0, next_s_ = 4.0;
  Eigen::MatrixXd feigned_, rate_;  // information, and a second's
  Eigen::VectorXd pull_;            // ½ T ∂(div ẋ)/∂η
  // Scratch.
  std::vector<double> jacobian_, at_estimate_;  // rows of one factor
  Eigen::MatrixXd half_;
  Square shown_;
  Eigen::LLT<Eigen::MatrixXd> llt_;
  Eigen::SelfAdjointEigenSolver<Square> eigen_;
  Eigen::VectorXd inflation_, turned_, scaled_;
};

}  // namespace odmc
