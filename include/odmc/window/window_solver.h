#pragma once

#include <memory>
#include <string>

#include "odmc/window/window.h"

namespace odmc {

/// How one solve of the window went.
struct SolveReport {
  bool usable = false;     ///< false: the window was left as it was
  bool converged = false;  ///< false: stopped by the iteration or time bound
  int iterations = 0;
  bool improved = false;      ///< at least one step was taken
  double initial_cost = 0.0;  ///< half the sum of squares, robust losses applied
  double final_cost = 0.0;
  std::string message;  ///< why it is not usable
};

/// Bounds of one solve.
struct SolverOptions {
  int max_iterations = 1;            ///< per update, >= 1
  double max_time_s = 0.008;         ///< per update, > 0
  double function_tolerance = 1e-6;  ///< relative change of cost that ends a solve
  int num_threads = 1;               ///< for Ceres' evaluation of factors, >= 1
};

/// Moves the window's states and parameters to the least-squares optimum of its factors and prior,
/// from where they are. What solves a window is apart from what it holds: an incremental solver
/// implements the same interface.
class WindowSolver {
 public:
  virtual ~WindowSolver() = default;
  virtual SolveReport Solve(Window* window, const SolverOptions& options) = 0;
};

/// Levenberg-Marquardt by eliminating the chain of states, oldest first and parameters last, in
/// dense fronts. Takes the same steps as Ceres does, without building and analysing a sparse
/// problem at every keyframe.
class EliminationWindowSolver final : public WindowSolver {
 public:
  EliminationWindowSolver();
  ~EliminationWindowSolver() override;
  SolveReport Solve(Window* window, const SolverOptions& options) override;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Levenberg-Marquardt by Ceres with SuiteSparse's sparse Cholesky: the reference.
class CeresWindowSolver final : public WindowSolver {
 public:
  CeresWindowSolver();
  ~CeresWindowSolver() override;
  SolveReport Solve(Window* window, const SolverOptions& options) override;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace odmc
