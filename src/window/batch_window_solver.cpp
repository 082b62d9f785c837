#include <Eigen/Cholesky>

#include "odmc/window/window_solver.h"

namespace odmc {

bool BatchWindowSolver::ParameterCovariance(const Window& window, const Eigen::VectorXd& sigma,
                                            Eigen::MatrixXd* covariance) {
  const Eigen::MatrixXd& information = information_.Update(window, 0.3 * sigma);
  const auto n = information.rows();
  *covariance = information.ldlt().solve(Eigen::MatrixXd::Identity(n, n));
  return covariance->allFinite() && (covariance->diagonal().array() > 0.0).all();
}

bool BatchWindowSolver::StateCovariance(const Window&, StateMatrix* covariance) {
  const Eigen::MatrixXd& information = information_.newest();
  if (information.rows() < kStateTangentSize) return false;
  const Eigen::LLT<Eigen::MatrixXd> llt(information);
  if (llt.info() != Eigen::Success) return false;
  Eigen::MatrixXd state = Eigen::MatrixXd::Zero(information.rows(), kStateTangentSize);
  state.topRows<kStateTangentSize>().setIdentity();
  *covariance = llt.solve(state).topRows<kStateTangentSize>();
  return covariance->allFinite();
}

bool BatchWindowSolver::MarginalizeOldest(Window* window, const Eigen::VectorXd& relinearize,
                                          LeavingFactors* leaving) {
  return odmc::MarginalizeOldest(window, relinearize, leaving);
}

const Eigen::MatrixXd& BatchWindowSolver::ScalePast(const Eigen::Ref<const Eigen::VectorXd>& scale,
                                                    Window* window) {
  root_ = RescalePrior(scale, window);
  information_.Rescale(root_);
  return root_;
}

const Eigen::MatrixXd& BatchWindowSolver::Reweigh(const Eigen::Ref<const Eigen::VectorXd>& scale,
                                                  std::function<void(Keyframe*)> weigh,
                                                  Window* window) {
  for (Keyframe& keyframe : window->keyframes()) weigh(&keyframe);
  root_ = RescalePrior(scale, window);
  information_.Forget();
  return root_;
}

void BatchWindowSolver::LetPastVary(int index, const ProcessStep& step, Window* window) {
  LetPriorVary(index, step, &window->prior());
  information_.Forget();  // what it keeps does not know of the variation
}

void BatchWindowSolver::LetPastWalk(const Eigen::Ref<const Eigen::VectorXd>& direction,
                                    double variance, Window* window) {
  LetPriorWalk(direction, variance, window);
  information_.Forget();
}

const Eigen::MatrixXd& BatchWindowSolver::PastInformation(const Window& window) {
  const Prior& prior = window.prior();
  const int n = window.layout().num_estimated();
  const LinearSystem left = Eliminate({prior.A, prior.b, static_cast<int>(prior.A.cols()) - n});
  past_information_.noalias() = left.A.transpose() * left.A;
  return past_information_;
}

}  // namespace odmc
