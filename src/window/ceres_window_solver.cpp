#include "odmc/window/ceres_window_solver.h"

#include <ceres/evaluation_callback.h>
#include <ceres/ordered_groups.h>
#include <ceres/problem.h>
#include <ceres/solver.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <deque>
#include <memory>

#include "odmc/factors/state_factors.h"
#include "odmc/window/marginalization.h"

namespace odmc {
namespace {

/// Ceres evaluates all Jacobians once more after the last step it may take, only to look at the
/// gradient. That is a fifth of an update. This counts the evaluations and says when the rest of
/// the solve has no use for Jacobians.
class JacobianBudget final : public ceres::EvaluationCallback {
 public:
  explicit JacobianBudget(int evaluations) : left_(evaluations) {}
  void PrepareForEvaluation(bool evaluate_jacobians, bool /*new_point*/) override {
    if (evaluate_jacobians && left_-- <= 0) spent_ = true;
  }
  bool spent() const { return spent_; }

 private:
  int left_;
  bool spent_ = false;
};

/// Forwards to a factor's cost function; zero Jacobians once the budget is spent.
class BudgetedCost final : public ceres::CostFunction {
 public:
  BudgetedCost(const ceres::CostFunction* cost, const JacobianBudget* budget)
      : cost_(cost), budget_(budget) {
    set_num_residuals(cost->num_residuals());
    *mutable_parameter_block_sizes() = cost->parameter_block_sizes();
  }
  bool Evaluate(double const* const* blocks, double* residual, double** jacobians) const override {
    if (jacobians == nullptr || !budget_->spent()) {
      return cost_->Evaluate(blocks, residual, jacobians);
    }
    for (size_t i = 0; i < parameter_block_sizes().size(); ++i) {
      if (jacobians[i] == nullptr) continue;
      std::fill_n(jacobians[i], num_residuals() * parameter_block_sizes()[i], 0.0);
    }
    return cost_->Evaluate(blocks, residual, nullptr);
  }

 private:
  const ceres::CostFunction* cost_;
  const JacobianBudget* budget_;
};

ceres::Solver::Options OptionsFor(const SolverOptions& options) {
  ceres::Solver::Options solver_options;
  solver_options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  solver_options.sparse_linear_algebra_library_type = ceres::SUITE_SPARSE;
  solver_options.max_num_iterations = options.max_iterations;
  solver_options.max_solver_time_in_seconds = options.max_time_s;
  solver_options.function_tolerance = options.function_tolerance;
  solver_options.num_threads = options.num_threads;
  solver_options.logging_type = ceres::SILENT;
  solver_options.initial_trust_region_radius = 1e6;
  solver_options.jacobi_scaling = false;  // eta and states are of order one already
  return solver_options;
}

/// Oldest state first, parameters last: the order in which a chain with a border fills least.
std::shared_ptr<ceres::ParameterBlockOrdering> OrderingOf(const ceres::Problem& problem,
                                                          Window* window) {
  auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  int group = 0;
  for (Keyframe& keyframe : window->keyframes()) {
    ordering->AddElementToGroup(keyframe.x.data(), group++);
  }
  for (Bias& bias : window->biases()) {
    if (problem.HasParameterBlock(bias.x.data())) ordering->AddElementToGroup(bias.x.data(), group);
  }
  if (window->eta().size() > 0) ordering->AddElementToGroup(window->eta().data(), group + 1);
  return ordering;
}

SolveReport ReportOf(const ceres::Solver::Summary& summary, const Window& window) {
  SolveReport report;
  report.usable = summary.IsSolutionUsable() && window.eta().allFinite();
  report.converged = summary.termination_type == ceres::CONVERGENCE;
  report.iterations = static_cast<int>(summary.iterations.size());
  report.improved = summary.num_successful_steps > 1;  // the starting point counts as one
  report.initial_cost = summary.initial_cost;
  report.final_cost = summary.final_cost;
  if (!report.usable) report.message = summary.message;
  return report;
}

}  // namespace

struct CeresWindowSolver::Impl {
  StateManifold state_manifold;
};

CeresWindowSolver::CeresWindowSolver(int fresh)
    : impl_(std::make_unique<Impl>()), information_(fresh) {}
CeresWindowSolver::~CeresWindowSolver() = default;

SolveReport CeresWindowSolver::Solve(Window* window, const SolverOptions& options) {
  window->MoveAnchor();
  ceres::Problem::Options problem_options;
  problem_options.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  problem_options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  problem_options.manifold_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  problem_options.disable_all_safety_checks = true;
  JacobianBudget budget(options.max_iterations);
  problem_options.evaluation_callback = &budget;
  ceres::Problem problem(problem_options);
  std::deque<BudgetedCost> costs;
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
      costs.emplace_back(factor.cost.get(), &budget);
      problem.AddResidualBlock(&costs.back(), const_cast<ceres::LossFunction*>(factor.loss),
                               window->MutableBlocks(factor));
    }
  }
  if (problem.HasParameterBlock(&window->anchor())) {
    problem.SetParameterBlockConstant(&window->anchor());
  }
  ceres::Solver::Options solver_options = OptionsFor(options);
  solver_options.linear_solver_ordering = OrderingOf(problem, window);
  ceres::Solver::Summary summary;
  ceres::Solve(solver_options, &problem, &summary);
  return ReportOf(summary, *window);
}

bool CeresWindowSolver::ParameterCovariance(const Window& window, const Eigen::VectorXd& sigma,
                                            Eigen::MatrixXd* covariance) {
  const Eigen::MatrixXd& information = information_.Update(window, 0.3 * sigma);
  const auto n = information.rows();
  *covariance = information.ldlt().solve(Eigen::MatrixXd::Identity(n, n));
  return covariance->allFinite() && (covariance->diagonal().array() > 0.0).all();
}

bool CeresWindowSolver::StateCovariance(const Window&, StateMatrix* covariance) {
  const Eigen::MatrixXd& information = information_.newest();
  if (information.rows() < kStateTangentSize) return false;
  const Eigen::LLT<Eigen::MatrixXd> llt(information);
  if (llt.info() != Eigen::Success) return false;
  Eigen::MatrixXd state = Eigen::MatrixXd::Zero(information.rows(), kStateTangentSize);
  state.topRows<kStateTangentSize>().setIdentity();
  *covariance = llt.solve(state).topRows<kStateTangentSize>();
  return covariance->allFinite();
}

bool CeresWindowSolver::MarginalizeOldest(Window* window, const Eigen::VectorXd& relinearize,
                                          LeavingFactors* leaving) {
  return odmc::MarginalizeOldest(window, relinearize, leaving);
}

const Eigen::MatrixXd& CeresWindowSolver::ScalePast(const Eigen::Ref<const Eigen::VectorXd>& scale,
                                                    Window* window) {
  root_ = RescalePrior(scale, window);
  information_.Rescale(root_);
  return root_;
}

const Eigen::MatrixXd& CeresWindowSolver::Reweigh(const Eigen::Ref<const Eigen::VectorXd>& scale,
                                                  std::function<void(Keyframe*)> weigh,
                                                  Window* window) {
  for (Keyframe& keyframe : window->keyframes()) weigh(&keyframe);
  root_ = RescalePrior(scale, window);
  information_.Forget();
  return root_;
}

void CeresWindowSolver::LetPastVary(int index, const ProcessStep& step, Window* window) {
  LetPriorVary(index, step, &window->prior());
  information_.Forget();  // what it keeps does not know of the variation
}

void CeresWindowSolver::LetPastWalk(const Eigen::Ref<const Eigen::VectorXd>& direction,
                                    double variance, Window* window) {
  LetPriorWalk(direction, variance, window);
  information_.Forget();
}

const Eigen::MatrixXd& CeresWindowSolver::PastInformation(const Window& window) {
  const Prior& prior = window.prior();
  const int n = window.layout().num_estimated();
  const LinearSystem left = Eliminate({prior.A, prior.b, static_cast<int>(prior.A.cols()) - n});
  past_information_.noalias() = left.A.transpose() * left.A;
  return past_information_;
}

}  // namespace odmc
