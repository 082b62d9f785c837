#include "odmc/estimator/regressor_noise.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "odmc/factors/manifolds.h"
#include "odmc/window/chain_front.h"

namespace odmc {
namespace {

constexpr double kLeastPeriod_s = 1.0;
constexpr double kPeriodShare = 0.1;  // of the flight so far
constexpr double kStep = 1e-3;        // of a parameter's natural size, in differences

/// The factor's rows in a buffer.
Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>> RowsOf(
    const Factor& factor, std::vector<double>* buffer, int n) {
  return {buffer->data(), factor.cost->num_residuals(), n};
}

/// Divergence of the velocities' and rates' derivatives by themselves [1/s], in the middle of an
/// interval, each over its noise level.
double Divergence(const DynamicsMeasurement& measurement, const State& state0, const State& state1,
                  const DynamicModel& model, const ModelValues& values,
                  const ProcessNoiseEstimator::Levels& levels) {
  const IntervalModel k(measurement, state0, state1, model, values, true, true);
  const auto& by_state = k.d_wrench.d_state;
  return by_state.block<3, 3>(0, kColumnAirVelocity).trace() / (levels.force * k.body.mass) +
         (k.body.I_BBcm_B.inverse() * by_state.block<3, 3>(3, kColumnAngularRate)).trace() /
             levels.torque;
}

}  // namespace

RegressorNoise::RegressorNoise(int num_parameters)
    : n_(num_parameters),
      feigned_(Eigen::MatrixXd::Zero(n_, n_)),
      rate_(feigned_),
      pull_(Eigen::VectorXd::Zero(n_)),
      jacobian_(static_cast<size_t>(kMostFactorRows * n_)),
      at_estimate_(jacobian_),
      half_(feigned_),
      shown_(Square::Zero(n_, n_)),
      llt_(std::max(n_, 1)),
      eigen_(std::max(n_, 1)),
      inflation_(Eigen::VectorXd::Ones(n_)),
      turned_(pull_),
      scaled_(pull_) {}

/// The whitened Jacobian by the parameters with the factor's states elsewhere, to jacobian_.
bool RegressorNoise::ParameterJacobian(const Window& window, const Factor& factor,
                                       const std::array<double, kStateSize>& x0,
                                       const std::array<double, kStateSize>& x1) {
  FactorBlocks blocks = window.Blocks(factor, false);
  int next = 0;
  if (factor.state0 >= 0) blocks.pointers[static_cast<size_t>(next++)] = x0.data();
  if (factor.state1 >= 0) blocks.pointers[static_cast<size_t>(next++)] = x1.data();
  next += (factor.bias0 >= 0 ? 1 : 0) + (factor.bias1 >= 0 ? 1 : 0);
  std::array<double, kMostFactorRows> residual;
  std::array<double*, 6> jacobians{};
  jacobians[static_cast<size_t>(next)] = jacobian_.data();
  return factor.cost->Evaluate(blocks.data(), residual.data(), jacobians.data()) &&
         RowsOf(factor, &jacobian_, n_).allFinite();
}

void RegressorNoise::AddPull(const DynamicsMeasurement& measurement, const Window& window,
                             const Keyframe& from, const Keyframe& to, const DynamicModel& model,
                             const ProcessNoiseEstimator::Levels& levels, double flown_s) {
  if (measurement.form != DynamicsForm::kMidpoint) return;
  DynamicsMeasurement own = measurement;
  own.anchor_index = -1;
  const State state0 = State::FromBlock(from.x.data()), state1 = State::FromBlock(to.x.data());
  const ParameterLayout& layout = window.layout();
  ModelValues values = window.values();
  const ParameterVector chain = layout.ChainFactors(values);
  const double here = Divergence(own, state0, state1, model, values, levels);
  for (int i = 0; i < n_; ++i) {
    const int k = layout.model_index(i);
    const double value = values[k];
    const double step = kStep * std::abs(chain[i]) * window.parameter_sigma()[i];
    values[k] = value + step;
    const double slope = (Divergence(own, state0, state1, model, values, levels) - here) / step;
    values[k] = value;
    if (std::isfinite(slope)) pull_[i] += 0.5 * (flown_s - counted_s_) * slope * chain[i];
  }
}

void RegressorNoise::Look(const Window& window, const DynamicModel& model,
                          const ProcessNoiseEstimator::Levels& levels,
                          const WindowSolver::StateMatrix& covariance, double flown_s) {
  next_s_ = flown_s + std::max(kLeastPeriod_s, kPeriodShare * flown_s);
  const auto& keyframes = window.keyframes();
  if (n_ == 0 || keyframes.size() < 2 || !covariance.allFinite()) return;
  const Keyframe &from = keyframes[keyframes.size() - 2], &to = keyframes.back();
  const double dt = ToSeconds(to.stamp - from.stamp);
  const Eigen::LLT<WindowSolver::StateMatrix> llt(covariance);
  if (!to.linked || dt <= 0.0 || llt.info() != Eigen::Success) return;
  const WindowSolver::StateMatrix L = llt.matrixL();
  const StateManifold manifold;
  rate_.setZero();
  for (const Factor& factor : from.factors) {
    if (!factor.parameters || factor.state0 < 0) continue;
    if (!ParameterJacobian(window, factor, from.x, to.x)) return;
    at_estimate_ = jacobian_;
    // Errors of neighbouring states are nearly the same: both move.
    for (int c = 0; c < kStateTangentSize; ++c) {
      std::array<double, kStateSize> x0, x1;
      manifold.Plus(from.x.data(), L.col(c).data(), x0.data());
      manifold.Plus(to.x.data(), L.col(c).data(), x1.data());
      if (!ParameterJacobian(window, factor, x0, x1)) return;
      auto change = RowsOf(factor, &jacobian_, n_);
      change -= RowsOf(factor, &at_estimate_, n_);
      rate_.noalias() += change.transpose() * change;
    }
  }
  from.ForEach<DynamicsFactor>([&](const Factor&, const DynamicsFactor& dynamics) {
    AddPull(dynamics.measurement(), window, from, to, model, levels, flown_s);
  });
  feigned_ += (flown_s - counted_s_) / dt * rate_;
  counted_s_ = flown_s;
}

void RegressorNoise::Rescale(const Eigen::MatrixXd& root) {
  half_.noalias() = root * feigned_;
  feigned_.noalias() = half_ * root.transpose();
}

void RegressorNoise::Forget(const Eigen::MatrixXd& root) {
  Rescale(root);
  turned_.noalias() = root.transpose() * pull_;
  pull_.noalias() = root * turned_;
}

const Eigen::VectorXd& RegressorNoise::Inflation(const Eigen::MatrixXd& covariance,
                                                 const Eigen::VectorXd& prior_sigma) {
  inflation_.setOnes(n_);
  if (n_ == 0 || counted_s_ == 0.0) return inflation_;
  // Information in units of the priors, without theirs and without what is feigned.
  llt_.compute(covariance);
  if (llt_.info() != Eigen::Success) return inflation_;
  shown_.setIdentity(n_, n_);
  llt_.solveInPlace(shown_);
  shown_ -= feigned_;
  for (int i = 0; i < n_; ++i) {
    for (int k = 0; k < n_; ++k) shown_(i, k) *= prior_sigma[i] * prior_sigma[k];
    shown_(i, i) -= 1.0;
  }
  if (!shown_.allFinite()) return inflation_;
  eigen_.compute(shown_);
  const auto& V = eigen_.eigenvectors();
  const auto share = [this](int k) { return 1.0 / (1.0 + std::max(eigen_.eigenvalues()[k], 0.0)); };
  scaled_ = pull_.cwiseProduct(prior_sigma);
  for (int k = 0; k < n_; ++k) turned_[k] = share(k) * V.col(k).dot(scaled_);
  for (int i = 0; i < n_; ++i) {
    double variance = 0.0, bias = 0.0;  // in units of the prior's
    for (int k = 0; k < n_; ++k) {
      variance += V(i, k) * V(i, k) * share(k);
      bias += V(i, k) * turned_[k];
    }
    variance = std::min(variance + bias * bias, 1.0);
    const double ratio = variance * prior_sigma[i] * prior_sigma[i] / covariance(i, i);
    inflation_[i] = std::sqrt(std::max(1.0, ratio));
  }
  return inflation_;
}

}  // namespace odmc
