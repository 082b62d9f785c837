#include "odmc/factors/interval_model.h"

#include "odmc/math/so3.h"

namespace odmc {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

/// tan(θ/4) n (3×1) of the turn by θ about n, |θ| <= π, from its quaternion.
Vector3d QuarterTurn(const Eigen::Quaterniond& q) {
  const double sign = q.w() < 0.0 ? -1.0 : 1.0;
  return q.vec() * (sign / (q.norm() + sign * q.w()));
}

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
                             const State& state1, const DynamicModel& dynamic_model,
                             const ModelValues& values, bool with_torque, bool jacobians)
    : model(&dynamic_model) {
  body = model->ShapedProperties(values, measurement.time_s, jacobians ? &d_body : nullptr);
  w0_S = state0.w_WS_S;
  w1_S = state1.w_WS_S;
  m0 = MotionOfBody(state0, body);
  m1 = MotionOfBody(state1, body);
  if (measurement.form == DynamicsForm::kMidpoint) {
    w0 = w1 = 0.5;
    const Vector3d t = body.R_BS * QuarterTurn(state0.q_WS.conjugate() * state1.q_WS);
    const Matrix3d t_hat = Hat(t);
    // Rotation by the quaternion (1, t), normalised: half the way.
    C1 = (2.0 / (1.0 + t.squaredNorm())) * (t_hat + t_hat * t_hat);
    C1.diagonal().array() += 1.0;
    C0 = C1.transpose();
    flight.R_WB.noalias() = m0.R_WB * C1;
    // ½ J_r(φ/2) J_r⁻¹(φ) = ½ (1 + tan(θ/4) [n]×) for φ = θ n, and the left ones likewise.
    A0 = 0.5 * (Matrix3d::Identity() - t_hat);
    A1 = 0.5 * (Matrix3d::Identity() + t_hat);
    R_BW = flight.R_WB.transpose();
  } else {
    w0 = 1.0;
    w1 = 0.0;
    flight.R_WB = m0.R_WB;
    R_BW = flight.R_WB.transpose();
    C0.setIdentity();
    C1.noalias() = R_BW * m1.R_WB;
    A0.setIdentity();
    A1.setZero();
  }
  flight.time_s = measurement.time_s;
  flight.p_WB = w0 * m0.p_WB + w1 * m1.p_WB;
  flight.v_AB_B = R_BW * (w0 * m0.v_WB + w1 * m1.v_WB - body.wind_W);
  flight.w_WB_B = w0 * m0.w_WB_B + w1 * m1.w_WB_B;
  flight.rotors = measurement.rotors;
  flight.load = measurement.load;
  const TorqueAnchor anchor = {measurement.anchor_index, measurement.anchor_value};
  model->EvaluateWrench(flight, values, body.p_BBcm, &F_B, &tau_B, jacobians ? &d_wrench : nullptr,
                        with_torque && anchor.index >= 0 ? &anchor : nullptr);
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
