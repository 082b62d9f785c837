#include <ceres/ordered_groups.h>
#include <ceres/problem.h>
#include <ceres/solver.h>

#include "odmc/factors/state_factors.h"
#include "odmc/window/window_solver.h"

namespace odmc {

struct CeresWindowSolver::Impl {
  StateManifold state_manifold;
};

CeresWindowSolver::CeresWindowSolver() : impl_(std::make_unique<Impl>()) {}
CeresWindowSolver::~CeresWindowSolver() = default;

SolveReport CeresWindowSolver::Solve(Window* window, const SolverOptions& options) {
  ceres::Problem::Options problem_options;
  problem_options.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  problem_options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  problem_options.manifold_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  problem_options.disable_all_safety_checks = true;
  ceres::Problem problem(problem_options);
  for (Keyframe& keyframe : window->keyframes()) {
    problem.AddParameterBlock(keyframe.x.data(), kStateSize, &impl_->state_manifold);
  }
  const MarginalizationFactor prior(window);
  if (prior.num_residuals() > 0) {
    problem.AddResidualBlock(const_cast<MarginalizationFactor*>(&prior), nullptr,
                             window->PriorBlocks());
  }
  // The parameters' own priors stay outside the marginal prior, so that either can be rescaled.
  std::unique_ptr<BlockPriorFactor> parameter_prior;
  if (window->eta().size() > 0) {
    parameter_prior =
        std::make_unique<BlockPriorFactor>(window->parameter_centre(), window->parameter_sigma());
    problem.AddResidualBlock(parameter_prior.get(), nullptr, window->eta().data());
  }
  for (Keyframe& keyframe : window->keyframes()) {
    for (Factor& factor : keyframe.factors) {
      problem.AddResidualBlock(factor.cost.get(), const_cast<ceres::LossFunction*>(factor.loss),
                               window->MutableBlocks(factor));
    }
  }
  ceres::Solver::Options solver_options;
  solver_options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  solver_options.sparse_linear_algebra_library_type = ceres::SUITE_SPARSE;
  solver_options.max_num_iterations = options.max_iterations;
  solver_options.max_solver_time_in_seconds = options.max_time_s;
  solver_options.function_tolerance = options.function_tolerance;
  solver_options.num_threads = options.num_threads;
  solver_options.logging_type = ceres::SILENT;
  solver_options.initial_trust_region_radius = 1e6;
  solver_options.jacobi_scaling = true;
  // Oldest state first, parameters last: the order in which a chain with a border fills least.
  auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  int group = 0;
  for (Keyframe& keyframe : window->keyframes()) {
    ordering->AddElementToGroup(keyframe.x.data(), group++);
  }
  for (Bias& bias : window->biases()) {
    if (problem.HasParameterBlock(bias.x.data())) ordering->AddElementToGroup(bias.x.data(), group);
  }
  if (window->eta().size() > 0) ordering->AddElementToGroup(window->eta().data(), group + 1);
  solver_options.linear_solver_ordering = ordering;
  ceres::Solver::Summary summary;
  ceres::Solve(solver_options, &problem, &summary);

  SolveReport report;
  report.usable = summary.IsSolutionUsable() && window->eta().allFinite();
  report.converged = summary.termination_type == ceres::CONVERGENCE;
  report.iterations = static_cast<int>(summary.iterations.size());
  report.improved = summary.num_successful_steps > 1;  // the starting point counts as one
  report.initial_cost = summary.initial_cost;
  report.final_cost = summary.final_cost;
  if (!report.usable) report.message = summary.message;
  return report;
}

}  // namespace odmc
