#include "odmc/factors/interval_model.h"

#include "odmc/math/so3.h"

namespace odmc {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

}  // namespace

BodyMotion MotionOfBody(const State& state, const BodyProperties& body) {
  BodyMotion motion;
  motion.R_WB = state.q_WS.toRotationMatrix() * body.R_BS.transpose();
  motion.w_WB_B = body.R_BS * state.w_WS_S;
  const Matrix3d& R = motion.R_WB;
  const Vector3d& w = motion.w_WB_B;
  const Vector3d p_SB = -body.p_BS;  // from So to Bo, in B
  const Vector3d p_SBcm = body.p_BBcm - body.p_BS;
  motion.v_WB = state.v_WS + R * w.cross(p_SB);
  motion.v_WBcm = state.v_WS + R * w.cross(p_SBcm);
  motion.p_WB = state.p_WS + R * p_SB;
  motion.p_WBcm = state.p_WS + R * p_SBcm;
  return motion;
}

IntervalModel::IntervalModel(const DynamicsMeasurement& measurement, const State& state0,
                             const State& state1, const DynamicModel& model,
                             const ModelValues& values, bool jacobians)
    : A0(Matrix3d::Identity()), A1(Matrix3d::Zero()) {
  body = model.Properties(values, jacobians ? &d_body : nullptr, measurement.time_s);
  for (int i = 0; i < 3; ++i) {
    if (!measurement.inertia_fixed[i]) continue;
    body.I_BBcm_B(i, i) = measurement.fixed_inertia[i];
    if (jacobians) d_body.row(kRowInertia + i).setZero();
  }
  shaped = &model.shaped_columns();
  w0_S = state0.w_WS_S;
  w1_S = state1.w_WS_S;
  m0 = MotionOfBody(state0, body);
  m1 = MotionOfBody(state1, body);
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
  flight.load = measurement.load;
  model.EvaluateWrench(flight, values, body.p_BBcm, &F_B, &tau_B, jacobians ? &d_wrench : nullptr);
  if (measurement.anchor_index < 0) return;
  if (values[measurement.anchor_index] == measurement.anchor_value) {
    if (jacobians) d_wrench.d_values.block<3, 1>(3, measurement.anchor_index).setZero();
    return;
  }
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
