#include "odmc/factors/state_factors.h"

#include "odmc/factors/manifolds.h"
#include "odmc/math/so3.h"

namespace odmc {

using Eigen::Matrix3d;
using Eigen::Vector3d;

namespace {

using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

template <int Rows>
void WriteStateJacobian(const Eigen::Matrix<double, Eigen::Dynamic, kStateTangentSize, 0, Rows,
                                            kStateTangentSize>& minimal,
                        const double* state, double* out) {
  Eigen::Map<RowMajor> J(out, minimal.rows(), kStateSize);
  J.leftCols<3>() = minimal.template leftCols<3>();
  J.middleCols<4>(3).noalias() =
      minimal.template middleCols<3>(3) * RotationManifold::Lift(state + 3);
  J.rightCols<6>() = minimal.template rightCols<6>();
}

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
  const Vector3d turn = Log(sample_.q_WS.conjugate() * state.q_WS);
  Eigen::Map<Vector3d>(residual + 0) = (state.p_WS - sample_.p_WS) / noise_.position_m;
  Eigen::Map<Vector3d>(residual + 3) = turn / noise_.attitude_rad;
  int row = 6;
  Eigen::Matrix<double, Eigen::Dynamic, kStateTangentSize, 0, 12, kStateTangentSize> J;
  J.setZero(num_residuals(), kStateTangentSize);
  J.block<3, 3>(0, kTangentPosition) = Matrix3d::Identity() / noise_.position_m;
  J.block<3, 3>(3, kTangentRotation) = RightJacobianInverse(turn) / noise_.attitude_rad;
  if (with_velocity_) {
    Eigen::Map<Vector3d>(residual + row) = (state.v_WS - *sample_.v_WS) / noise_.velocity_m_s;
    J.block<3, 3>(row, kTangentVelocity) = Matrix3d::Identity() / noise_.velocity_m_s;
    row += 3;
  }
  if (with_rate_) {
    Eigen::Map<Vector3d>(residual + row) = (state.w_WS_S - *sample_.w_WS_S) / noise_.rate_rad_s;
    J.block<3, 3>(row, kTangentRate) = Matrix3d::Identity() / noise_.rate_rad_s;
  }
  if (jacobians != nullptr && jacobians[0] != nullptr) {
    WriteStateJacobian<12>(J, blocks[0], jacobians[0]);
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
  Eigen::Matrix<double, Eigen::Dynamic, kStateTangentSize, 0, 6, kStateTangentSize> J0, J1;
  J0.setZero(num_residuals(), kStateTangentSize);
  J1.setZero(num_residuals(), kStateTangentSize);
  int row = 0;
  if (!euler_) {
    const Matrix3d scale = Matrix3d::Identity() / sigma_position_;
    Eigen::Map<Vector3d>(residual + 0) =
        (s1.p_WS - s0.p_WS - 0.5 * dt_ * (s0.v_WS + s1.v_WS)) / sigma_position_;
    J0.block<3, 3>(0, kTangentPosition) = -scale;
    J1.block<3, 3>(0, kTangentPosition) = scale;
    J0.block<3, 3>(0, kTangentVelocity) = -0.5 * dt_ * scale;
    J1.block<3, 3>(0, kTangentVelocity) = -0.5 * dt_ * scale;
    row = 3;
  }
  if (with_rotation_) {
    const double w0 = euler_ ? 1.0 : 0.5;
    const Vector3d phi = Log(s0.q_WS.conjugate() * s1.q_WS);
    Eigen::Map<Vector3d>(residual + row) =
        (phi - dt_ * (w0 * s0.w_WS_S + (1.0 - w0) * s1.w_WS_S)) / sigma_rotation_;
    J0.block<3, 3>(row, kTangentRotation) = -LeftJacobianInverse(phi) / sigma_rotation_;
    J1.block<3, 3>(row, kTangentRotation) = RightJacobianInverse(phi) / sigma_rotation_;
    J0.block<3, 3>(row, kTangentRate) = -w0 * dt_ * Matrix3d::Identity() / sigma_rotation_;
    J1.block<3, 3>(row, kTangentRate) = -(1.0 - w0) * dt_ * Matrix3d::Identity() / sigma_rotation_;
  }
  if (jacobians != nullptr) {
    if (jacobians[0] != nullptr) WriteStateJacobian<6>(J0, blocks[0], jacobians[0]);
    if (jacobians[1] != nullptr) WriteStateJacobian<6>(J1, blocks[1], jacobians[1]);
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
