#include "odmc/factors/state_factors.h"

#include <algorithm>

#include "odmc/factors/manifolds.h"
#include "odmc/math/so3.h"

namespace odmc {

using Eigen::Matrix3d;
using Eigen::Vector3d;

namespace {

using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// A Jacobian by one state's 13 numbers, filled in place; does nothing where Ceres passes null.
class AmbientJacobian {
 public:
  AmbientJacobian(int rows, const double* state, double* out) : state_(state), out_(out) {
    if (out_ != nullptr) std::fill_n(out_, rows * kStateSize, 0.0);
  }
  /// Derivative `x` times identity by p_WS, v_WS or w_WS_S, of three rows from `row` on.
  void SetPosition(int row, double x) { SetDiagonal(row, 0, x); }
  void SetVelocity(int row, double x) { SetDiagonal(row, 7, x); }
  void SetRate(int row, double x) { SetDiagonal(row, 10, x); }
  /// Derivative by the rotation's tangent (3×3).
  void SetRotation(int row, const Matrix3d& d_theta) {
    if (out_ == nullptr) return;
    Eigen::Map<RowMajor>(out_, row + 3, kStateSize).block<3, 4>(row, 3).noalias() =
        d_theta * RotationManifold::Lift(state_ + 3);
  }

 private:
  void SetDiagonal(int row, int column, double x) {
    if (out_ == nullptr) return;
    for (int i = 0; i < 3; ++i) out_[(row + i) * kStateSize + column + i] = x;
  }

  const double* state_;
  double* out_;
};

}  // namespace

void OdometryFactor::Set(const OdometrySample& sample, const OdometryNoise& noise, bool with_rate) {
  sample_ = sample;
  noise_ = noise;
  with_velocity_ = sample.v_WS.has_value();
  with_rate_ = with_rate && sample.w_WS_S.has_value();
  set_num_residuals(6 + (with_velocity_ ? 3 : 0) + (with_rate_ ? 3 : 0));
  mutable_parameter_block_sizes()->assign(1, kStateSize);
}

bool OdometryFactor::Evaluate(double const* const* blocks, double* residual,
                              double** jacobians) const {
  const State state = State::FromBlock(blocks[0]);
  Matrix3d d_turn;
  const Vector3d turn = Log(sample_.q_WS.conjugate() * state.q_WS, &d_turn);
  AmbientJacobian J(num_residuals(), blocks[0], jacobians != nullptr ? jacobians[0] : nullptr);
  Eigen::Map<Vector3d>(residual + 0) = (state.p_WS - sample_.p_WS) / noise_.position_m;
  J.SetPosition(0, 1.0 / noise_.position_m);
  Eigen::Map<Vector3d>(residual + 3) = turn / noise_.attitude_rad;
  J.SetRotation(3, d_turn / noise_.attitude_rad);
  int row = 6;
  if (with_velocity_) {
    Eigen::Map<Vector3d>(residual + row) = (state.v_WS - *sample_.v_WS) / noise_.velocity_m_s;
    J.SetVelocity(row, 1.0 / noise_.velocity_m_s);
    row += 3;
  }
  if (with_rate_) {
    Eigen::Map<Vector3d>(residual + row) = (state.w_WS_S - *sample_.w_WS_S) / noise_.rate_rad_s;
    J.SetRate(row, 1.0 / noise_.rate_rad_s);
  }
  return Eigen::Map<Eigen::VectorXd>(residual, num_residuals()).allFinite();
}

void KinematicFactor::Set(double dt, DynamicsForm form, double sigma_position_m,
                          double sigma_rotation_rad, bool with_rotation) {
  dt_ = dt;
  euler_ = form == DynamicsForm::kEuler;
  with_rotation_ = with_rotation;
  sigma_position_ = sigma_position_m;
  sigma_rotation_ = sigma_rotation_rad;
  set_num_residuals((euler_ ? 0 : 3) + (with_rotation_ ? 3 : 0));
  mutable_parameter_block_sizes()->assign(2, kStateSize);
}

bool KinematicFactor::Evaluate(double const* const* blocks, double* residual,
                               double** jacobians) const {
  const State s0 = State::FromBlock(blocks[0]), s1 = State::FromBlock(blocks[1]);
  AmbientJacobian J0(num_residuals(), blocks[0], jacobians != nullptr ? jacobians[0] : nullptr);
  AmbientJacobian J1(num_residuals(), blocks[1], jacobians != nullptr ? jacobians[1] : nullptr);
  int row = 0;
  if (!euler_) {
    Eigen::Map<Vector3d>(residual + 0) =
        (s1.p_WS - s0.p_WS - 0.5 * dt_ * (s0.v_WS + s1.v_WS)) / sigma_position_;
    J0.SetPosition(0, -1.0 / sigma_position_);
    J1.SetPosition(0, 1.0 / sigma_position_);
    J0.SetVelocity(0, -0.5 * dt_ / sigma_position_);
    J1.SetVelocity(0, -0.5 * dt_ / sigma_position_);
    row = 3;
  }
  if (with_rotation_) {
    const double w0 = euler_ ? 1.0 : 0.5;
    Matrix3d J_r;
    const Vector3d phi = Log(s0.q_WS.conjugate() * s1.q_WS, &J_r);
    Eigen::Map<Vector3d>(residual + row) =
        (phi - dt_ * (w0 * s0.w_WS_S + (1.0 - w0) * s1.w_WS_S)) / sigma_rotation_;
    // The left Jacobian is the right one's transpose.
    J0.SetRotation(row, J_r.transpose() / -sigma_rotation_);
    J1.SetRotation(row, J_r / sigma_rotation_);
    J0.SetRate(row, -w0 * dt_ / sigma_rotation_);
    J1.SetRate(row, -(1.0 - w0) * dt_ / sigma_rotation_);
  }
  return Eigen::Map<Eigen::VectorXd>(residual, num_residuals()).allFinite();
}

BlockPriorFactor::BlockPriorFactor(const Eigen::VectorXd& mean, const Eigen::VectorXd& sigma)
    : mean_(mean), sigma_(sigma) {
  set_num_residuals(static_cast<int>(mean.size()));
  mutable_parameter_block_sizes()->assign(1, static_cast<int>(mean.size()));
}

bool BlockPriorFactor::Evaluate(double const* const* blocks, double* residual,
                                double** jacobians) const {
  const Eigen::Map<const Eigen::VectorXd> x(blocks[0], mean_.size());
  Eigen::Map<Eigen::VectorXd>(residual, mean_.size()) = (x - mean_).cwiseQuotient(sigma_);
  if (jacobians != nullptr && jacobians[0] != nullptr) {
    Eigen::Map<RowMajor>(jacobians[0], mean_.size(), mean_.size()) =
        sigma_.cwiseInverse().asDiagonal();
  }
  return true;
}

void BiasWalkFactor::Set(const Eigen::Matrix<double, 6, 1>& sigma) {
  sigma_ = sigma;
  set_num_residuals(6);
  mutable_parameter_block_sizes()->assign(2, 6);
}

bool BiasWalkFactor::Evaluate(double const* const* blocks, double* residual,
                              double** jacobians) const {
  using Vector6d = Eigen::Matrix<double, 6, 1>;
  const Eigen::Map<const Vector6d> b0(blocks[0]), b1(blocks[1]);
  Eigen::Map<Vector6d> r(residual);
  r = (b1 - b0).cwiseQuotient(sigma_);
  if (jacobians != nullptr) {
    const Eigen::Matrix<double, 6, 6> W = sigma_.cwiseInverse().asDiagonal();
    WriteJacobian(-W, jacobians[0]);
    WriteJacobian(W, jacobians[1]);
  }
  return true;
}

}  // namespace odmc
