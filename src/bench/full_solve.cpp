#include "odmc/bench/full_solve.h"

#include <cmath>

#include "odmc/window/ceres_window_solver.h"
#include "odmc/window/saved_window.h"

namespace odmc {
namespace {

/// @returns the covariance of eta (n×n); nothing where the solve failed
std::optional<Eigen::MatrixXd> SolveToConvergence(Window* window) {
  SolverOptions options;
  options.max_iterations = 30;
  options.max_time_s = 60.0;
  options.function_tolerance = 1e-12;
  CeresWindowSolver reference;
  for (int pass = 0; pass < 2; ++pass) {  // the anchor follows the solution
    if (!reference.Solve(window, options).usable) return std::nullopt;
  }
  Eigen::MatrixXd covariance;
  const Eigen::VectorXd unknown = Eigen::VectorXd::Zero(window->eta().size());
  if (!reference.ParameterCovariance(*window, unknown, &covariance)) return std::nullopt;
  return covariance;
}

FullSolveDifference Difference(const SolvedWindow& solved, const ParameterVector& our_eta,
                               const Eigen::MatrixXd& ours, const Eigen::MatrixXd& full) {
  FullSolveDifference difference;
  for (int i = 0; i < our_eta.size(); ++i) {
    const double sigma = std::sqrt(full(i, i));
    const double moved = std::abs(our_eta[i] - solved.window->eta()[i]) / sigma;
    const double wider = std::abs(std::sqrt(ours(i, i)) / sigma - 1.0);
    const int k = solved.window->layout().model_index(i);
    const std::string& name = solved.model.parameters()[k].full_name;
    if (moved > difference.parameters) {
      difference.parameters = moved;
      difference.worst_parameter = name;
    }
    if (wider > difference.sigmas) {
      difference.sigmas = wider;
      difference.worst_sigma = name;
    }
  }
  return difference;
}

}  // namespace

std::optional<FullSolveDifference> CompareWithFullSolve(const SolvedWindow& solved) {
  Window* const window = solved.window;
  Eigen::MatrixXd ours;
  if (window->keyframes().empty() ||
      !solved.solver->ParameterCovariance(*window, solved.sigma_eta, &ours)) {
    return std::nullopt;
  }
  const SavedWindow point(*window);
  solved.solver->WritePrior(window);
  std::optional<FullSolveDifference> difference;
  const auto compare = [&] {
    const std::optional<Eigen::MatrixXd> full = SolveToConvergence(window);
    if (full) difference = Difference(solved, point.eta(), ours, *full);
  };
  if (solved.solve.reweighing) {  // the problem it solves has the old weights
    solved.model_noise.WithSizesBefore(window, compare);
  } else {
    compare();
  }
  point.Restore(window);
  return difference;
}

}  // namespace odmc
