#include "odmc/factors/interval_model.h"

#include "odmc/math/so3.h"

namespace odmc {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

}  // namespace

BodyMotion MotionOfBody(const State& state, const BodyProperties& body, BodyMotionJacobians* J) {
  BodyMotion motion;
  const Matrix3d& Q = body.R_BS;
  motion.R_WB = state.q_WS.toRotationMatrix() * Q.transpose();
  motion.w_WB_B = Q * state.w_WS_S;
  const Matrix3d& R = motion.R_WB;
  const Vector3d& w = motion.w_WB_B;
  const Vector3d p_SB = -body.p_BS;  // from So to Bo, in B
  const Vector3d p_SBcm = body.p_BBcm - body.p_BS;
  motion.v_WB = state.v_WS + R * w.cross(p_SB);
  motion.v_WBcm = state.v_WS + R * w.cross(p_SBcm);
  motion.p_WB = state.p_WS + R * p_SB;
  motion.p_WBcm = state.p_WS + R * p_SBcm;
  if (J == nullptr) return motion;

  // First with respect to theta_B and w_B, then carried to theta_S, w_S and theta_BS.
  J->d_state.setZero();
  J->d_mount.setZero();
  const Matrix3d d_w_d_mount = -Q * Hat(state.w_WS_S);
  J->d_state.block<3, 3>(kMotionRotation, kTangentRotation) = Q;
  J->d_mount.block<3, 3>(kMotionRotation, 3) = -Q;
  J->d_state.block<3, 3>(kMotionRate, kTangentRate) = Q;
  J->d_mount.block<3, 3>(kMotionRate, 3) = d_w_d_mount;
  const auto velocity = [&](int row, const Vector3d& arm, bool to_com) {
    const Matrix3d d_theta_B = -R * Hat(w.cross(arm));
    const Matrix3d d_w_B = -R * Hat(arm);
    const Matrix3d d_arm = R * Hat(w);
    J->d_state.block<3, 3>(row, kTangentVelocity).setIdentity();
    J->d_state.block<3, 3>(row, kTangentRotation) = d_theta_B * Q;
    J->d_state.block<3, 3>(row, kTangentRate) = d_w_B * Q;
    J->d_mount.block<3, 3>(row, 0) = -d_arm;
    J->d_mount.block<3, 3>(row, 3) = -d_theta_B * Q + d_w_B * d_w_d_mount;
    if (to_com) J->d_mount.block<3, 3>(row, 6) = d_arm;
  };
  const auto position = [&](int row, const Vector3d& arm, bool to_com) {
    const Matrix3d d_theta_B = -R * Hat(arm);
    J->d_state.block<3, 3>(row, kTangentPosition).setIdentity();
    J->d_state.block<3, 3>(row, kTangentRotation) = d_theta_B * Q;
    J->d_mount.block<3, 3>(row, 0) = -R;
    J->d_mount.block<3, 3>(row, 3) = -d_theta_B * Q;
    if (to_com) J->d_mount.block<3, 3>(row, 6) = R;
  };
  velocity(kMotionVelocity, p_SB, false);
  velocity(kMotionComVelocity, p_SBcm, true);
  position(kMotionPosition, p_SB, false);
  position(kMotionComPosition, p_SBcm, true);
  return motion;
}

IntervalModel::IntervalModel(const DynamicsMeasurement& measurement, const State& state0,
                             const State& state1, const DynamicModel& model,
                             const ModelValues& values, bool jacobians)
    : A0(Matrix3d::Identity()), A1(Matrix3d::Zero()) {
  body = model.Properties(values, jacobians ? &d_body : nullptr);
  for (int i = 0; i < 3; ++i) {
    if (!measurement.inertia_fixed[i]) continue;
    body.I_BBcm_B(i, i) = measurement.fixed_inertia[i];
    if (jacobians) d_body.row(kRowInertia + i).setZero();
  }
  m0 = MotionOfBody(state0, body, jacobians ? &d_m0 : nullptr);
  m1 = MotionOfBody(state1, body, jacobians ? &d_m1 : nullptr);
  const bool midpoint = measurement.form == DynamicsForm::kMidpoint;
  w0 = midpoint ? 0.5 : 1.0;
  w1 = 1.0 - w0;
  flight.R_WB = m0.R_WB;
  if (midpoint) {
    const Vector3d phi = Log(Eigen::Quaterniond(Matrix3d(m0.R_WB.transpose() * m1.R_WB)));
    flight.R_WB = m0.R_WB * Exp(0.5 * phi).toRotationMatrix();
    if (jacobians) {
      A0 = 0.5 * LeftJacobian(0.5 * phi) * LeftJacobianInverse(phi);
      A1 = 0.5 * RightJacobian(0.5 * phi) * RightJacobianInverse(phi);
    }
  }
  R_BW = flight.R_WB.transpose();
  flight.time_s = measurement.time_s;
  flight.p_WB = w0 * m0.p_WB + w1 * m1.p_WB;
  flight.v_AB_B = R_BW * (w0 * m0.v_WB + w1 * m1.v_WB - body.wind_W);
  flight.w_WB_B = w0 * m0.w_WB_B + w1 * m1.w_WB_B;
  flight.rotors = measurement.rotors;
  model.EvaluateWrench(flight, values, body.p_BBcm, &F_B, &tau_B, jacobians ? &d_wrench : nullptr);
  if (measurement.anchor_index < 0) return;
  ModelValues anchored = values;
  anchored[measurement.anchor_index] = measurement.anchor_value;
  Vector3d unused;
  ModelWrenchJacobians d_anchored;
  model.EvaluateWrench(flight, anchored, body.p_BBcm, &unused, &tau_B,
                       jacobians ? &d_anchored : nullptr);
  if (!jacobians) return;
  d_wrench.d_state.bottomRows<3>() = d_anchored.d_state.bottomRows<3>();
  d_wrench.d_p_BBcm.bottomRows<3>() = d_anchored.d_p_BBcm.bottomRows<3>();
  d_wrench.d_values.bottomRows<3>() = d_anchored.d_values.bottomRows<3>();
  d_wrench.d_values.block<3, 1>(3, measurement.anchor_index).setZero();
}

Eigen::Matrix<double, 3, 6> InertiaProductDerivative(const Eigen::Vector3d& a) {
  Eigen::Matrix<double, 3, 6> D = Eigen::Matrix<double, 3, 6>::Zero();
  D.leftCols<3>() = a.asDiagonal();
  D.col(3) << a.y(), a.x(), 0.0;
  D.col(4) << a.z(), 0.0, a.x();
  D.col(5) << 0.0, a.z(), a.y();
  return D;
}

}  // namespace odmc
