#include "odmc/factors/dynamics_factor.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <cmath>
#include <stdexcept>

#include "odmc/factors/manifolds.h"

namespace odmc {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

/// Derivatives of the nine rows with respect to the interval's pieces.           model.md section 6
IntervalDerivatives<kNumDynamicsRows> RowDerivatives(const DynamicsMeasurement& measurement,
                                                     const IntervalModel& k,
                                                     const Matrix3d& I_inverse, const Vector3d& f,
                                                     const Vector3d& a_p,
                                                     const Vector3d& e_alpha) {
  const double dt = measurement.dt;
  const double m = k.body.mass;
  const Vector3d& w = k.flight.w_WB_B;
  const Matrix3d& I = k.body.I_BBcm_B;
  IntervalDerivatives<kNumDynamicsRows> D;
  D.d_wrench.block<3, 3>(kRowVelocity, 0) = -dt * Matrix3d::Identity();
  D.d_wrench.block<3, 3>(kRowAngular, 3) = -dt * I_inverse;
  D.d_theta.middleRows<3>(kRowVelocity) = m * Hat(f);
  D.d_rate.middleRows<3>(kRowAngular) = dt * I_inverse * (Hat(w) * I - Hat(I * w));
  D.d_motion0.block<3, 3>(kRowVelocity, kMotionComVelocity) = -m * k.R_BW;
  D.d_motion1.block<3, 3>(kRowVelocity, kMotionComVelocity) = m * k.R_BW;
  D.d_motion0.block<3, 3>(kRowAngular, kMotionRate) = -Matrix3d::Identity();
  D.d_motion1.block<3, 3>(kRowAngular, kMotionRate) = Matrix3d::Identity();
  D.d_body.block<3, 1>(kRowVelocity, kRowMass) = f;
  D.d_body.block<3, 3>(kRowVelocity, kRowGravity) = -m * dt * k.R_BW;
  const Vector3d dw = k.m1.w_WB_B - k.m0.w_WB_B;
  D.d_body.block<3, 6>(kRowAngular, kRowInertia) =
      I_inverse * (InertiaProductDerivative(dw) + dt * Hat(w) * InertiaProductDerivative(w) -
                   InertiaProductDerivative(e_alpha));
  if (measurement.form != DynamicsForm::kEuler) return D;
  D.d_wrench.block<3, 3>(kRowPosition, 0) = -0.5 * dt * dt * Matrix3d::Identity();
  D.d_theta.middleRows<3>(kRowPosition) = m * Hat(a_p);
  D.d_motion0.block<3, 3>(kRowPosition, kMotionComPosition) = -m * k.R_BW;
  D.d_motion1.block<3, 3>(kRowPosition, kMotionComPosition) = m * k.R_BW;
  D.d_motion0.block<3, 3>(kRowPosition, kMotionComVelocity) = -m * dt * k.R_BW;
  D.d_body.block<3, 1>(kRowPosition, kRowMass) = a_p;
  D.d_body.block<3, 3>(kRowPosition, kRowGravity) = -0.5 * m * dt * dt * k.R_BW;
  return D;
}

}  // namespace

Eigen::Matrix<double, kNumDynamicsRows, 1> DynamicsResidual(
    const DynamicsMeasurement& measurement, const State& state0, const State& state1,
    const DynamicModel& model, const ModelValues& values, Vector3d* inertia,
    DynamicsJacobians* J) {
  const double dt = measurement.dt;
  const IntervalModel k(measurement, state0, state1, model, values, J != nullptr);
  const double m = k.body.mass;
  const Matrix3d& I = k.body.I_BBcm_B;
  const Matrix3d I_inverse = I.inverse();
  const Vector3d& g_W = k.body.g_W;
  const Vector3d& w = k.flight.w_WB_B;
  const Vector3d dw = k.m1.w_WB_B - k.m0.w_WB_B;
  const Vector3d f = k.R_BW * (k.m1.v_WBcm - k.m0.v_WBcm - dt * g_W);
  const Vector3d a_p =
      k.R_BW * (k.m1.p_WBcm - k.m0.p_WBcm - dt * k.m0.v_WBcm - 0.5 * dt * dt * g_W);
  const Vector3d e_alpha = dw + I_inverse * (dt * w.cross(I * w) - dt * k.tau_B);

  Eigen::Matrix<double, kNumDynamicsRows, 1> e;
  e.setZero();
  if (measurement.form == DynamicsForm::kEuler) {
    e.segment<3>(kRowPosition) = m * a_p - 0.5 * dt * dt * k.F_B;
  }
  e.segment<3>(kRowVelocity) = m * f - dt * k.F_B;
  e.segment<3>(kRowAngular) = e_alpha;
  if (inertia != nullptr) *inertia = I.diagonal();
  if (J != nullptr) {
    AssembleJacobians(k, RowDerivatives(measurement, k, I_inverse, f, a_p, e_alpha), &J->d_state0,
                      &J->d_state1, &J->d_values);
    J->d_inertia = k.d_body.middleRows<3>(kRowInertia);
  }
  return e;
}

Eigen::Matrix2d EulerTranslationCovariance(double dt) {
  Eigen::Matrix2d P;
  P << dt * dt * dt * dt / 3.0, dt * dt * dt / 2.0, dt * dt * dt / 2.0, dt * dt;
  return P;
}

DynamicsFactor::DynamicsFactor(const DynamicsMeasurement& measurement, const DynamicsNoise& noise,
                               bool with_torque, const DynamicModel* model,
                               const ParameterLayout* layout)
    : measurement_(measurement),
      noise_(noise),
      with_torque_(with_torque),
      model_(model),
      layout_(layout) {
  if (!(measurement.dt > 0.0)) throw std::invalid_argument("DynamicsFactor: dt must be positive");
  set_num_residuals(velocity_row() + 3 + (with_torque ? 3 : 0));
  *mutable_parameter_block_sizes() = BlockSizes(2, false, *layout);
}

bool DynamicsFactor::Evaluate(double const* const* blocks, double* residual_out,
                              double** jacobians) const {
  const ModelValues values = layout_->Decode(layout_->num_estimated() > 0 ? blocks[2] : nullptr);
  DynamicsJacobians J;
  Vector3d inertia;
  Eigen::Matrix<double, 9, 1> e =
      DynamicsResidual(measurement_, State::FromBlock(blocks[0]), State::FromBlock(blocks[1]),
                       *model_, values, &inertia, jacobians != nullptr ? &J : nullptr);
  const double dt = measurement_.dt;
  Eigen::Matrix<double, 9, 9> W = Eigen::Matrix<double, 9, 9>::Zero();
  const Vector3d rotor_force(0.0, 0.0, noise_.rotor_force_N);
  const Vector3d force_sigma =
      (noise_.force_N.array().square() + rotor_force.array().square()).sqrt();
  if (measurement_.form == DynamicsForm::kEuler) {
    const Eigen::Matrix2d sqrt_info =
        EulerTranslationCovariance(dt).llt().matrixL().solve(Eigen::Matrix2d::Identity());
    for (int i = 0; i < 3; ++i) {
      W(kRowPosition + i, kRowPosition + i) = sqrt_info(0, 0) / force_sigma[i];
      W(kRowVelocity + i, kRowPosition + i) = sqrt_info(1, 0) / force_sigma[i];
      W(kRowVelocity + i, kRowVelocity + i) = sqrt_info(1, 1) / force_sigma[i];
    }
  } else {
    for (int i = 0; i < 3; ++i) W(kRowVelocity + i, kRowVelocity + i) = 1.0 / (dt * force_sigma[i]);
  }
  Vector3d d_log_weight_d_inertia;
  for (int i = 0; i < 3; ++i) {
    const double fixed = noise_.torque_Nm[i] / noise_.nominal_inertia[i];
    const double rotor = noise_.rotor_torque_Nm[i] / inertia[i];
    const double variance = fixed * fixed + rotor * rotor;
    W(kRowAngular + i, kRowAngular + i) = 1.0 / (dt * std::sqrt(variance));
    d_log_weight_d_inertia[i] = rotor * rotor / (variance * inertia[i]);
  }

  const int first_row = 3 - velocity_row();
  const int rows = num_residuals();
  const Eigen::Matrix<double, 9, 1> whitened = W * e;
  Eigen::Map<Eigen::VectorXd>(residual_out, rows) = whitened.segment(first_row, rows);
  if (jacobians != nullptr) {
    for (int k = 0; k < 2; ++k) {
      if (jacobians[k] == nullptr) continue;
      const Eigen::Matrix<double, 9, kStateSize> lifted =
          StateManifold::Lift(W * (k == 0 ? J.d_state0 : J.d_state1), blocks[k]);
      WriteJacobian(lifted.middleRows(first_row, rows), jacobians[k]);
    }
    ValueJacobian<9> d_values = W * J.d_values;
    for (int i = 0; i < 3; ++i) {
      d_values.row(kRowAngular + i) +=
          whitened[kRowAngular + i] * d_log_weight_d_inertia[i] * J.d_inertia.row(i);
    }
    if (layout_->num_estimated() > 0) {
      const ValueJacobian<Eigen::Dynamic> kept = d_values.middleRows(first_row, rows);
      WriteParameterJacobian<Eigen::Dynamic>(*layout_, values, kept, jacobians[2]);
    }
  }
  return whitened.allFinite();
}

bool DynamicsFactor::UnwhitenedResidual(double const* const* blocks,
                                        Eigen::Matrix<double, kNumDynamicsRows, 1>* e) const {
  *e = DynamicsResidual(measurement_, State::FromBlock(blocks[0]), State::FromBlock(blocks[1]),
                        *model_, layout_->Decode(layout_->num_estimated() > 0 ? blocks[2] : nullptr));
  return e->allFinite();
}

std::vector<int32_t> BlockSizes(int states, bool bias, const ParameterLayout& layout) {
  std::vector<int32_t> sizes(states, kStateSize);
  if (bias) sizes.push_back(6);
  if (layout.num_estimated() > 0) sizes.push_back(layout.num_estimated());
  return sizes;
}

}  // namespace odmc
