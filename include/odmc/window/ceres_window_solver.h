#pragma once

#include <Eigen/Core>
#include <functional>
#include <memory>

#include "odmc/window/parameter_information.h"
#include "odmc/window/window_solver.h"

namespace odmc {

/// Levenberg-Marquardt by Ceres with SuiteSparse's sparse Cholesky: the reference. Solves the whole
/// window at once and keeps the past in its prior (marginalization.h).
class CeresWindowSolver final : public WindowSolver {
 public:
  /// @param fresh newest keyframes whose factors may have changed (ParameterInformation)
  explicit CeresWindowSolver(int fresh = 3);
  ~CeresWindowSolver() override;

  SolveReport Solve(Window* window, const SolverOptions& options) override;
  bool ParameterCovariance(const Window& window, const Eigen::VectorXd& sigma,
                           Eigen::MatrixXd* covariance) override;
  bool StateCovariance(const Window& window, StateMatrix* covariance) override;
  bool MarginalizeOldest(Window* window, const Eigen::VectorXd& relinearize,
                         LeavingFactors* leaving) override;
  const Eigen::MatrixXd& ScalePast(const Eigen::Ref<const Eigen::VectorXd>& scale,
                                   Window* window) override;
  const Eigen::MatrixXd& Reweigh(const Eigen::Ref<const Eigen::VectorXd>& scale,
                                 std::function<void(Keyframe*)> weigh, Window* window) override;
  void LetPastVary(int index, const ProcessStep& step, Window* window) override;
  void LetPastWalk(const Eigen::Ref<const Eigen::VectorXd>& direction, double variance,
                   Window* window) override;
  const Eigen::MatrixXd& PastInformation(const Window& window) override;
  void WritePrior(Window*) override {}
  void Release(Window*) override { information_.Forget(); }

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
  ParameterInformation information_;
  Eigen::MatrixXd root_, past_information_;
};

}  // namespace odmc
