#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "odmc/factors/state.h"
#include "odmc/model/dynamic_model.h"

namespace odmc {

/// How the equations of motion are discretised over one interval.
enum class DynamicsForm {
  kMidpoint,  ///< Form M, model.md 4.2: the default
  kEuler,     ///< Form E, model.md 4.1: the paper's, corrected, for comparison
};

/// What one interval between keyframes 0 and 1 measured besides the states.
struct DynamicsMeasurement {
  double dt = 0.0;      ///< [s], > 0
  double time_s = 0.0;  ///< of its middle, since the flight's start
  RotorState rotors;    ///< means over the interval (Form M), values at its start (Form E)
  LoadPull load;        ///< of a suspended load, in the interval's middle
  DynamicsForm form = DynamicsForm::kMidpoint;
  /// Axes whose inertia is held at `fixed_inertia` whatever the values say, because the flight
  /// cannot tell it from the rest (see InertiaGate).
  std::array<bool, 3> inertia_fixed = {false, false, false};
  Eigen::Vector3d fixed_inertia = Eigen::Vector3d::Zero();  ///< [kg m²]
  /// Index of the thrust coefficient in the model's values, or -1. Where set, the torque takes it
  /// at `anchor_value` instead of the value given, so that only the force equation informs it. With
  /// inertia, k_f and k_m free the torque equation is homogeneous and is satisfied best by
  /// vanishing coefficients; what the torque does not explain must not bend k_f that way.
  int anchor_index = -1;
  double anchor_value = 0.0;
};

/// Motion of the body at one keyframe, from the state of S and the mount.            model.md 6.1
struct BodyMotion {
  Eigen::Matrix3d R_WB;
  Eigen::Vector3d w_WB_B;  ///< [rad/s]
  Eigen::Vector3d v_WB;    ///< of Bo, in W [m/s]
  Eigen::Vector3d v_WBcm;  ///< of the centre of mass, in W [m/s]
  Eigen::Vector3d p_WB;    ///< of Bo [m]
  Eigen::Vector3d p_WBcm;  ///< of the centre of mass [m]
};

/// Rows of BodyMotion's derivatives.
enum BodyMotionRow : int {
  kMotionRotation = 0,
  kMotionRate = 3,
  kMotionVelocity = 6,
  kMotionComVelocity = 9,
  kMotionPosition = 12,
  kMotionComPosition = 15,
  kNumMotionRows = 18,
};

/// Takes the sensor's motion to the body's.                        model.md 6.1, paper Eq. (20)
BodyMotion MotionOfBody(const State& state, const BodyProperties& body);

/// Derivative with respect to all values of a model.
template <int N>
using ValueJacobian =
    Eigen::Matrix<double, N, Eigen::Dynamic, 0, (N > 0 ? N : 9), kMaxModelParameters>;

/// The model over one interval: motion at both ends and, at the point where the form evaluates the
/// equations (the middle, or keyframe 0), attitude, flight state, force and torque.
struct IntervalModel {
  IntervalModel(const DynamicsMeasurement& measurement, const State& state0, const State& state1,
                const DynamicModel& model, const ModelValues& values, bool jacobians);

  BodyProperties body;
  BodyMotion m0, m1;
  Eigen::Matrix3d R_BW;  ///< at the evaluation point
  double w0, w1;         ///< weights of the keyframes in velocities and rates
  FlightState flight;
  Eigen::Vector3d F_B;    ///< [N]
  Eigen::Vector3d tau_B;  ///< about the centre of mass [N m]

  // Derivatives, filled on request.
  BodyPropertiesJacobian d_body;
  const std::vector<DynamicModel::ColumnRange>* shaped;  ///< columns of d_body that are not zero
  Eigen::Vector3d w0_S, w1_S;                            ///< rates of the states, in S
  Eigen::Matrix3d A0, A1;  ///< d theta at the point / d theta_B at either end (model.md 6.2)
  ModelWrenchJacobians d_wrench;
};

/// How a residual of N rows depends on the pieces of an IntervalModel; AssembleJacobians() does the
/// chain rule once for all factors.
template <int N>
struct IntervalDerivatives {
  Eigen::Matrix<double, N, 6> d_wrench = Eigen::Matrix<double, N, 6>::Zero();
  Eigen::Matrix<double, N, 3> d_theta = Eigen::Matrix<double, N, 3>::Zero();  ///< at the point
  Eigen::Matrix<double, N, 3> d_rate = Eigen::Matrix<double, N, 3>::Zero();   ///< at the point
  Eigen::Matrix<double, N, kNumMotionRows> d_motion0 =
      Eigen::Matrix<double, N, kNumMotionRows>::Zero();
  Eigen::Matrix<double, N, kNumMotionRows> d_motion1 =
      Eigen::Matrix<double, N, kNumMotionRows>::Zero();
  Eigen::Matrix<double, N, kNumBodyPropertyRows> d_body =
      Eigen::Matrix<double, N, kNumBodyPropertyRows>::Zero();
};

/// Derivatives of a residual by one keyframe's motion, carried to the state's tangent (N×12), and
/// added to those by the mount: p_BS, theta_BS, p_BBcm (N×3 each).                  model.md 6.1
template <int N>
void CarryToState(const Eigen::Matrix<double, N, kNumMotionRows>& d_motion,
                  const BodyMotion& motion, const BodyProperties& body,
                  const Eigen::Vector3d& w_WS_S,
                  Eigen::Matrix<double, N, kStateTangentSize>* d_state,
                  Eigen::Matrix<double, N, kNumBodyPropertyRows>* d_body) {
  using Block = Eigen::Matrix<double, N, 3>;
  const Eigen::Matrix3d& Q = body.R_BS;
  const Eigen::Vector3d& w = motion.w_WB_B;
  const Eigen::Vector3d arm = -body.p_BS, com_arm = body.p_BBcm - body.p_BS;
  // Of world vectors, written in B.
  const Block d_v = d_motion.template middleCols<3>(kMotionVelocity) * motion.R_WB;
  const Block d_v_com = d_motion.template middleCols<3>(kMotionComVelocity) * motion.R_WB;
  const Block d_p = d_motion.template middleCols<3>(kMotionPosition) * motion.R_WB;
  const Block d_p_com = d_motion.template middleCols<3>(kMotionComPosition) * motion.R_WB;
  const Block d_theta_B = d_motion.template middleCols<3>(kMotionRotation) -
                          d_v * Hat(w.cross(arm)) - d_v_com * Hat(w.cross(com_arm)) -
                          d_p * Hat(arm) - d_p_com * Hat(com_arm);
  const Block d_w_B =
      d_motion.template middleCols<3>(kMotionRate) - d_v * Hat(arm) - d_v_com * Hat(com_arm);
  const Eigen::Matrix3d w_hat = Hat(w);
  d_state->template middleCols<3>(kTangentPosition) =
      d_motion.template middleCols<3>(kMotionPosition) +
      d_motion.template middleCols<3>(kMotionComPosition);
  d_state->template middleCols<3>(kTangentVelocity) =
      d_motion.template middleCols<3>(kMotionVelocity) +
      d_motion.template middleCols<3>(kMotionComVelocity);
  const Block d_theta = d_theta_B * Q, d_w = d_w_B * Q;
  d_state->template middleCols<3>(kTangentRotation) = d_theta;
  d_state->template middleCols<3>(kTangentRate) = d_w;
  d_body->template middleCols<3>(kRowOdometryPosition) -= (d_v + d_v_com) * w_hat + d_p + d_p_com;
  d_body->template middleCols<3>(kRowOdometryRotation) -= d_theta + d_w * Hat(w_WS_S);
  d_body->template middleCols<3>(kRowCom) += d_v_com * w_hat + d_p_com;
}

/// Derivatives with respect to both states' tangents (N×12) and all values (N×num_parameters()).
template <int N>
void AssembleJacobians(const IntervalModel& interval, IntervalDerivatives<N> D,
                       Eigen::Matrix<double, N, kStateTangentSize>* d_state0,
                       Eigen::Matrix<double, N, kStateTangentSize>* d_state1,
                       ValueJacobian<N>* d_values) {
  using Block = Eigen::Matrix<double, N, 3>;
  const auto& d_flight = interval.d_wrench.d_state;
  const Block d_air = D.d_wrench * d_flight.template middleCols<3>(kColumnAirVelocity);
  const Block d_rate = D.d_rate + D.d_wrench * d_flight.template middleCols<3>(kColumnAngularRate);
  const Block d_position = D.d_wrench * d_flight.template middleCols<3>(kColumnPosition);
  const Block d_theta = D.d_theta + D.d_wrench * d_flight.template middleCols<3>(kColumnAttitude) +
                        d_air * Hat(interval.flight.v_AB_B);
  const Block d_air_W = d_air * interval.R_BW;
  const auto carry = [&](const Eigen::Matrix3d& A, double weight, auto* d_motion) {
    d_motion->template middleCols<3>(kMotionRotation) += d_theta * A;
    d_motion->template middleCols<3>(kMotionVelocity) += weight * d_air_W;
    d_motion->template middleCols<3>(kMotionRate) += weight * d_rate;
    d_motion->template middleCols<3>(kMotionPosition) += weight * d_position;
  };
  carry(interval.A0, interval.w0, &D.d_motion0);
  carry(interval.A1, interval.w1, &D.d_motion1);
  CarryToState(D.d_motion0, interval.m0, interval.body, interval.w0_S, d_state0, &D.d_body);
  CarryToState(D.d_motion1, interval.m1, interval.body, interval.w1_S, d_state1, &D.d_body);
  D.d_body.template middleCols<3>(kRowCom) += D.d_wrench * interval.d_wrench.d_p_BBcm;
  D.d_body.template middleCols<3>(kRowWind) -= d_air_W;
  *d_values = (D.d_wrench * interval.d_wrench.d_values).eval();
  for (const DynamicModel::ColumnRange& range : *interval.shaped) {
    d_values->middleCols(range.first, range.count).noalias() +=
        D.d_body * interval.d_body.middleCols(range.first, range.count);
  }
}

/// Derivative of I a with respect to (xx, yy, zz, xy, xz, yz) (3×6).                model.md 12.14
Eigen::Matrix<double, 3, 6> InertiaProductDerivative(const Eigen::Vector3d& a);

}  // namespace odmc
