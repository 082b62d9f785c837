#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "odmc/factors/manifolds.h"
#include "odmc/factors/parameter_layout.h"
#include "odmc/factors/state.h"
#include "odmc/math/so3.h"
#include "odmc/model/dynamic_model.h"

namespace odmc {

/// How the equations of motion are discretised over one interval.
enum class DynamicsForm {
  kMidpoint,  ///< Form M, model.md 4.2, Eq. (M7), (M8): the default
  kEuler,     ///< Form E, model.md 4.1, Eq. (M6): the paper's, corrected, for comparison
};

/// What one interval between keyframes 0 and 1 measured besides the states.
struct DynamicsMeasurement {
  double dt = 0.0;      ///< [s], > 0
  double time_s = 0.0;  ///< of its middle, since the flight's start
  RotorState rotors;    ///< means over the interval (Form M), values at its start (Form E)
  LoadPull load;        ///< of a suspended load, in the interval's middle
  DynamicsForm form = DynamicsForm::kMidpoint;
  /// Axes about which the flight cannot tell the inertia from the rest (see InertiaGate): their
  /// rows of the torque equation take the inertia about all such axes as `fixed_inertia`, whatever
  /// the values say. Rows of other axes take the values, which they couple (w × I w): what is not
  /// known about one axis is an uncertainty of the others.
  std::array<bool, 3> inertia_fixed = {false, false, false};
  Eigen::Vector3d fixed_inertia = Eigen::Vector3d::Zero();  ///< [kg m²]
  /// Index of the thrust coefficient in the model's values, or -1. Where set, the torque takes it
  /// at `anchor_value` instead of the value given, so that only the force equation informs it. With
  /// inertia, k_f and k_m free the torque equation is homogeneous and is satisfied best by
  /// vanishing coefficients; what the torque does not explain must not bend k_f that way.
  /// DynamicsFactor takes the value from a block of its own.
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

/// Takes the sensor's motion to the body's.                        model.md 6.1, paper Eq. (20)
BodyMotion MotionOfBody(const State& state, const BodyProperties& body);

/// Derivative with respect to all values of a model.
template <int N>
using ValueJacobian =
    Eigen::Matrix<double, N, Eigen::Dynamic, 0, (N > 0 ? N : 9), kMaxModelParameters>;

/// The model over one interval: motion at both ends and, at the point where the form evaluates the
/// equations (the middle, or keyframe 0), attitude, flight state, force and torque.
struct IntervalModel {
  /// @param with_torque false if the torque is not used: its anchor is then left aside
  IntervalModel(const DynamicsMeasurement& measurement, const State& state0, const State& state1,
                const DynamicModel& model, const ModelValues& values, bool with_torque,
                bool jacobians);

  BodyProperties body;
  BodyMotion m0, m1;
  Eigen::Matrix3d R_BW;    ///< at the evaluation point
  Eigen::Matrix3d C0, C1;  ///< take vectors from B at either end to B at the point
  double w0, w1;           ///< weights of the keyframes in velocities and rates
  FlightState flight;
  Eigen::Vector3d F_B;    ///< [N]
  Eigen::Vector3d tau_B;  ///< about the centre of mass [N m]

  // Derivatives, filled on request.
  const DynamicModel* model;
  BodyPropertiesJacobian d_body;
  Eigen::Vector3d w0_S, w1_S;  ///< rates of the states, in S
  /// d theta at the point / d theta_B at either end; model.md 6.2, Eq. (M21).
  Eigen::Matrix3d A0, A1;
  ModelWrenchJacobians d_wrench;
};

/// How a residual of N rows depends on the pieces of an IntervalModel; AssembleJacobians() does the
/// chain rule once for all factors. All zero at first.
template <int N>
struct IntervalDerivatives {
  /// Columns of the derivatives by one keyframe's motion. Those by vectors of W are written in B at
  /// the evaluation point.
  enum Motion : int {
    kAttitude = 0,
    kRate = 3,          ///< w_WB_B
    kVelocity = 6,      ///< v_WB
    kComVelocity = 9,   ///< v_WBcm
    kPosition = 12,     ///< p_WB
    kComPosition = 15,  ///< p_WBcm
    kNumMotionColumns = 18,
  };

  auto d_wrench() { return all.template leftCols<6>(); }
  auto d_theta() { return all.template middleCols<3>(6); }  ///< attitude at the point
  auto d_rate() { return all.template middleCols<3>(9); }   ///< w_WB_B at the point
  auto d_motion0() { return all.template middleCols<kNumMotionColumns>(12); }
  auto d_motion1() { return all.template middleCols<kNumMotionColumns>(12 + kNumMotionColumns); }
  auto d_body() { return all.template rightCols<kNumBodyPropertyRows>(); }

  static constexpr int kNumColumns = 12 + 2 * kNumMotionColumns + kNumBodyPropertyRows;
  /// In one piece, since zeroing many small ones takes longer than filling them.
  Eigen::Matrix<double, N, kNumColumns> all = Eigen::Matrix<double, N, kNumColumns>::Zero();
  bool by_position = false;  ///< whether the derivatives by p_WB and p_WBcm are not all zero
};

/// Derivatives of a residual by one keyframe's motion, carried to the state's tangent (N×12), and
/// added to those by the mount: p_BS, theta_BS, p_BBcm (N×3 each).                  model.md 6.1
/// @param D all derivatives, of which `d_motion` are those by this keyframe's motion
/// @param C takes vectors from B at the keyframe to B at the evaluation point
/// @param d_state null: only what the mount needs is done
template <int N, typename Motion>
void CarryToState(const Motion& d_motion, const Eigen::Matrix3d& C, const IntervalModel& interval,
                  const BodyMotion& motion, const Eigen::Vector3d& w_WS_S,
                  IntervalDerivatives<N>* D, Eigen::Matrix<double, N, kStateTangentSize>* d_state) {
  using Block = Eigen::Matrix<double, N, 3>;
  using Columns = IntervalDerivatives<N>;
  const BodyProperties& body = interval.body;
  const Eigen::Matrix3d& Q = body.R_BS;
  const Eigen::Vector3d& w = motion.w_WB_B;
  const Eigen::Vector3d arm = -body.p_BS, com_arm = body.p_BBcm - body.p_BS;
  const auto d_velocity = d_motion.template middleCols<3>(Columns::kVelocity);
  const auto d_com_velocity = d_motion.template middleCols<3>(Columns::kComVelocity);
  auto d_body = D->d_body();
  if (d_state == nullptr && !interval.model->shapes_mounts() && !D->by_position) {
    auto d_com = d_body.template middleCols<3>(kRowCom);
    SubtractTimesHat(Block(d_com_velocity * C), -w, &d_com);
    return;
  }
  Eigen::Matrix<double, N, kStateTangentSize> unused;
  if (d_state == nullptr) d_state = &unused;
  auto d_p_BS = d_body.template middleCols<3>(kRowOdometryPosition);
  auto d_theta_BS = d_body.template middleCols<3>(kRowOdometryRotation);
  auto d_com = d_body.template middleCols<3>(kRowCom);
  // Of world vectors, written in B at the keyframe.
  const Block d_v = d_velocity * C;
  const Block d_v_com = d_com_velocity * C;
  Block d_theta_B = d_motion.template middleCols<3>(Columns::kAttitude);
  SubtractTimesHat(d_v, w.cross(arm), &d_theta_B);
  SubtractTimesHat(d_v_com, w.cross(com_arm), &d_theta_B);
  Block d_w_B = d_motion.template middleCols<3>(Columns::kRate);
  SubtractTimesHat(d_v, arm, &d_w_B);
  SubtractTimesHat(d_v_com, com_arm, &d_w_B);
  SubtractTimesHat(d_v_com, -w, &d_com);
  d_state->template middleCols<3>(kTangentVelocity).noalias() =
      (d_velocity + d_com_velocity) * interval.R_BW;
  if (D->by_position) {
    const auto d_position = d_motion.template middleCols<3>(Columns::kPosition);
    const auto d_com_position = d_motion.template middleCols<3>(Columns::kComPosition);
    const Block d_p = d_position * C;
    const Block d_p_com = d_com_position * C;
    SubtractTimesHat(d_p, arm, &d_theta_B);
    SubtractTimesHat(d_p_com, com_arm, &d_theta_B);
    d_state->template middleCols<3>(kTangentPosition).noalias() =
        (d_position + d_com_position) * interval.R_BW;
    d_p_BS -= d_p + d_p_com;
    d_com += d_p_com;
  } else {
    d_state->template middleCols<3>(kTangentPosition).setZero();
  }
  const Block d_theta = d_theta_B * Q, d_w = d_w_B * Q;
  d_state->template middleCols<3>(kTangentRotation) = d_theta;
  d_state->template middleCols<3>(kTangentRate) = d_w;
  if (!interval.model->shapes_mounts()) return;
  SubtractTimesHat(d_v + d_v_com, w, &d_p_BS);
  d_theta_BS -= d_theta;
  SubtractTimesHat(d_w, w_WS_S, &d_theta_BS);
}

/// Adds D d_body to the derivative by parameter `k`; most of d_body is zero.
template <int N, typename Body, typename Column>
void AddBodyColumn(const DynamicModel& model, const BodyPropertiesJacobian& d_body, const Body& D,
                   int k, Column* sum) {
  const BodyPropertyRows& rows = model.shaped_rows(k);
  const double* const x = d_body.data() + kNumBodyPropertyRows * k;
  for (int row = rows.first; row < rows.first + rows.count; ++row) {
    *sum += x[row] * D.template block<N, 1>(0, row);
  }
}

/// Derivatives with respect to both states' tangents (N×12) and to the model's parameters
/// `columns`, in that order (N×columns.size()). Spends `D`. Those by the states are left out where
/// null.
template <int N>
void AssembleJacobians(const IntervalModel& interval, const std::vector<int>& columns,
                       IntervalDerivatives<N>* D,
                       Eigen::Matrix<double, N, kStateTangentSize>* d_state0,
                       Eigen::Matrix<double, N, kStateTangentSize>* d_state1,
                       ValueJacobian<N>* d_values) {
  using Block = Eigen::Matrix<double, N, 3>;
  using Columns = IntervalDerivatives<N>;
  const auto& d_flight = interval.d_wrench.d_state;
  const Eigen::Matrix<double, N, 6> d_wrench = D->d_wrench();
  const Block d_air = d_wrench * d_flight.template middleCols<3>(kColumnAirVelocity);
  const Block d_rate = D->d_rate() + d_wrench * d_flight.template middleCols<3>(kColumnAngularRate);
  Block d_theta = D->d_theta();
  SubtractTimesHat(d_air, -interval.flight.v_AB_B, &d_theta);
  Block d_position;
  const bool by_pose = interval.d_wrench.by_pose;
  if (by_pose) {
    d_theta += d_wrench * d_flight.template middleCols<3>(kColumnAttitude);
    d_position = d_wrench * d_flight.template middleCols<3>(kColumnPosition) *
                 interval.flight.R_WB;  // by a vector of W written in B
    D->by_position = true;
  }
  const auto carry = [&](const Eigen::Matrix3d& A, double weight, auto d_motion) {
    d_motion.template middleCols<3>(Columns::kAttitude).noalias() += d_theta * A;
    d_motion.template middleCols<3>(Columns::kVelocity) += weight * d_air;
    d_motion.template middleCols<3>(Columns::kRate) += weight * d_rate;
    if (by_pose) d_motion.template middleCols<3>(Columns::kPosition) += weight * d_position;
  };
  carry(interval.A0, interval.w0, D->d_motion0());
  carry(interval.A1, interval.w1, D->d_motion1());
  CarryToState(D->d_motion0(), interval.C0, interval, interval.m0, interval.w0_S, D, d_state0);
  CarryToState(D->d_motion1(), interval.C1, interval, interval.m1, interval.w1_S, D, d_state1);
  auto d_body = D->d_body();
  d_body.template middleCols<3>(kRowCom).noalias() += d_wrench * interval.d_wrench.d_p_BBcm;
  d_body.template middleCols<3>(kRowWind).noalias() -= d_air * interval.R_BW;
  d_values->resize(N, columns.size());
  for (size_t i = 0; i < columns.size(); ++i) {
    const int k = columns[i];
    Eigen::Matrix<double, N, 1> column = Eigen::Matrix<double, N, 1>::Zero();
    if (interval.model->makes_wrench(k)) {
      const double* const w = interval.d_wrench.d_values.data() + 6 * k;
      for (int row = 0; row < 6; ++row) column += w[row] * d_wrench.col(row);
    }
    AddBodyColumn<N>(*interval.model, interval.d_body, d_body, k, &column);
    d_values->col(i) = column;
  }
}

/// Writes `rows` rows of a state's derivatives to Ceres' array `out`, lifted to its 13 numbers.
template <int N>
void WriteStateJacobian(const Eigen::Matrix<double, N, kStateTangentSize>& d_state, int rows,
                        const double* state, double* out) {
  if (out == nullptr) return;
  const Eigen::Matrix<double, N, 4> d_q =
      d_state.template middleCols<3>(kTangentRotation) * RotationManifold::Lift(state + 3);
  for (int row = 0; row < rows; ++row, out += kStateSize) {
    for (int i = 0; i < 3; ++i) out[i] = d_state(row, kTangentPosition + i);
    for (int i = 0; i < 4; ++i) out[3 + i] = d_q(row, i);
    for (int i = 0; i < 6; ++i) out[7 + i] = d_state(row, kTangentVelocity + i);
  }
}

/// Takes `rows` rows of derivatives with respect to the layout's physical values to eta and writes
/// them to Ceres' array `out`.
template <int N>
void WriteParameterJacobian(const ParameterLayout& layout, const ModelValues& values,
                            const ValueJacobian<N>& d_values, int rows, double* out) {
  if (out == nullptr) return;
  const int n = layout.num_estimated();
  const ParameterVector chain = layout.ChainFactors(values);
  for (int i = 0; i < n; ++i) {
    for (int row = 0; row < rows; ++row) out[row * n + i] = chain[i] * d_values(row, i);
  }
}

/// Derivative of I a with respect to (xx, yy, zz, xy, xz, yz) (3×6). The last three columns are
/// Λ(a) of model.md 12.14, Eq. (M26).
Eigen::Matrix<double, 3, 6> InertiaProductDerivative(const Eigen::Vector3d& a);

}  // namespace odmc
