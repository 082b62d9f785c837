#pragma once

#include <Eigen/Core>
#include <functional>
#include <limits>
#include <string>

#include "odmc/window/marginalization.h"
#include "odmc/window/window.h"

namespace odmc {

/// How one solve of the window went.
struct SolveReport {
  bool usable = false;     ///< false: the window was left as it was
  bool converged = false;  ///< false: stopped by the iteration or time bound
  int iterations = 0;
  bool improved = false;  ///< at least one step was taken
  /// Half the sum of squares, robust losses applied; 0 from the incremental solver, which never
  /// adds them up.
  double initial_cost = 0.0;
  double final_cost = 0.0;
  std::string message;  ///< why it is not usable

  /// What it took, in keyframes linearized and eliminated once (7 to 12 us each); what else a solve
  /// does counts by the time it takes. 0 from Ceres.
  int work = 0;

  // Of the incremental solver.
  int eliminated = 0;        ///< keyframes, by the chain in use and the sweep
  int back_substituted = 0;  ///< keyframes
  bool reweighing = false;   ///< the estimate does not have the weights of Reweigh() yet
  bool sweeping = false;     ///< older keyframes wait for a new linearization
  bool aligned = false;      ///< the window was solved as a whole (ChainAlignment)
};

/// Bounds of one solve.
struct SolverOptions {
  int max_iterations = 1;  ///< per update, >= 1
  /// The start of a flight, or after a step that was refused: a linear model of the window may not
  /// do, solve it as a whole.
  bool align = false;
  double max_time_s = 0.008;  ///< per update, > 0
  /// Of SolveReport::work, per update, > 0: what goes beyond is done in the next updates. The
  /// incremental solver keeps to it, but where it has no chain to go on from.
  int max_work = std::numeric_limits<int>::max();
  double function_tolerance = 1e-6;  ///< relative change of cost that ends a solve
  int num_threads = 1;               ///< for Ceres' evaluation of factors, >= 1
};

/// Moves the window's states and parameters to the least-squares optimum of its factors and prior,
/// from where they are, and keeps what has left the window: how a window is solved, apart from what
/// it holds. One solver serves one window from its start on.
class WindowSolver {
 public:
  using StateMatrix = Eigen::Matrix<double, kStateTangentSize, kStateTangentSize>;

  virtual ~WindowSolver() = default;

  virtual SolveReport Solve(Window* window, const SolverOptions& options) = 0;

  /// Covariance of the parameters' eta (n×n) at the solution, all states, biases and the past taken
  /// into account.
  /// @param sigma the last one known, to judge by how far parameters have moved (n)
  /// @returns false if it is not positive
  virtual bool ParameterCovariance(const Window& window, const Eigen::VectorXd& sigma,
                                   Eigen::MatrixXd* covariance) = 0;

  /// Covariance of the newest state's tangent, after ParameterCovariance() of the same window.
  /// @returns false if a direction of it is not known
  virtual bool StateCovariance(const Window& window, StateMatrix* covariance) = 0;

  /// Takes the oldest keyframe out of the window; what it said stays known (marginalization.h).
  virtual bool MarginalizeOldest(Window* window, const Eigen::VectorXd& relinearize,
                                 LeavingFactors* leaving) = 0;

  /// Puts what it keeps of the window back into it and forgets the rest: keyframes may then be
  /// taken off before the next solve, which is to align.
  virtual void Release(Window* window) = 0;

  /// RescalePrior() of what has left. @returns the root of the scale, until the next call
  virtual const Eigen::MatrixXd& ScalePast(const Eigen::Ref<const Eigen::VectorXd>& scale,
                                           Window* window) = 0;

  /// The same where factors of the window change their weights with it: both take effect together,
  /// at once or some solves later (SolveReport::reweighing).
  /// @param weigh gives the factors of a keyframe their new weights; kept until all have them
  virtual const Eigen::MatrixXd& Reweigh(const Eigen::Ref<const Eigen::VectorXd>& scale,
                                         std::function<void(Keyframe*)> weigh, Window* window) = 0;

  /// LetPriorVary() of what has left.
  virtual void LetPastVary(int index, const ProcessStep& step, Window* window) = 0;

  /// LetPriorWalk() of what has left.
  virtual void LetPastWalk(const Eigen::Ref<const Eigen::VectorXd>& direction, double variance,
                           Window* window) = 0;

  /// Information of what has left about the parameters alone (n×n), until the next call.
  virtual const Eigen::MatrixXd& PastInformation(const Window& window) = 0;

  /// Makes window->prior() hold what has left, for a solve by somebody else.
  virtual void WritePrior(Window* window) = 0;
};

}  // namespace odmc
