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

/// First rows of e_v and e_alpha where N rows are evaluated: 9 with e_p, 6 without.
template <int N>
constexpr int kVelocityRow = N - 6;
template <int N>
constexpr int kAngularRow = N - 3;

template <int N>
struct Derivatives {
  Eigen::Matrix<double, N, kStateTangentSize> d_state0, d_state1;
  ValueJacobian<N> d_values;
  ValueJacobian<3> d_inertia;
};

/// What the residual is made of, besides the interval's model.
struct Terms {
  Matrix3d I_inverse;
  Vector3d f, a_p, e_alpha;
};

/// Derivatives of the rows with respect to the interval's pieces.                model.md section 6
template <int N>
IntervalDerivatives<N> RowDerivatives(const DynamicsMeasurement& measurement,
                                      const IntervalModel& k, const Terms& terms) {
  constexpr int v = kVelocityRow<N>, a = kAngularRow<N>;
  const double dt = measurement.dt;
  const double m = k.body.mass;
  const Vector3d& w = k.flight.w_WB_B;
  const Matrix3d& I = k.body.I_BBcm_B;
  const Matrix3d mR = m * k.R_BW;
  IntervalDerivatives<N> D;
  D.d_wrench.template block<3, 3>(v, 0) = -dt * Matrix3d::Identity();
  D.d_wrench.template block<3, 3>(a, 3) = -dt * terms.I_inverse;
  D.d_theta.template middleRows<3>(v) = m * Hat(terms.f);
  D.d_rate.template middleRows<3>(a) = dt * terms.I_inverse * (Hat(w) * I - Hat(I * w));
  D.d_motion0.template block<3, 3>(v, kMotionComVelocity) = -mR;
  D.d_motion1.template block<3, 3>(v, kMotionComVelocity) = mR;
  D.d_motion0.template block<3, 3>(a, kMotionRate) = -Matrix3d::Identity();
  D.d_motion1.template block<3, 3>(a, kMotionRate) = Matrix3d::Identity();
  D.d_body.template block<3, 1>(v, kRowMass) = terms.f;
  D.d_body.template block<3, 3>(v, kRowGravity) = -dt * mR;
  const Vector3d dw = k.m1.w_WB_B - k.m0.w_WB_B;
  D.d_body.template block<3, 6>(a, kRowInertia) =
      terms.I_inverse * (InertiaProductDerivative(dw) + dt * Hat(w) * InertiaProductDerivative(w) -
                         InertiaProductDerivative(terms.e_alpha));
  if constexpr (N == 9) {
    if (measurement.form == DynamicsForm::kEuler) {
      D.d_wrench.template block<3, 3>(0, 0) = -0.5 * dt * dt * Matrix3d::Identity();
      D.d_theta.template middleRows<3>(0) = m * Hat(terms.a_p);
      D.d_motion0.template block<3, 3>(0, kMotionComPosition) = -mR;
      D.d_motion1.template block<3, 3>(0, kMotionComPosition) = mR;
      D.d_motion0.template block<3, 3>(0, kMotionComVelocity) = -dt * mR;
      D.d_body.template block<3, 1>(0, kRowMass) = terms.a_p;
      D.d_body.template block<3, 3>(0, kRowGravity) = -0.5 * dt * dt * mR;
    }
  }
  return D;
}

/// The residual's rows (9 with e_p, 6 without) and, on request, their derivatives.
template <int N>
Eigen::Matrix<double, N, 1> EvaluateRows(const DynamicsMeasurement& measurement,
                                         const State& state0, const State& state1,
                                         const DynamicModel& model, const ModelValues& values,
                                         Vector3d* inertia, Derivatives<N>* J) {
  const double dt = measurement.dt;
  const IntervalModel k(measurement, state0, state1, model, values, J != nullptr);
  const double m = k.body.mass;
  const Matrix3d& I = k.body.I_BBcm_B;
  const Vector3d& g_W = k.body.g_W;
  const Vector3d& w = k.flight.w_WB_B;
  Terms terms;
  terms.I_inverse = I.inverse();
  terms.f = k.R_BW * (k.m1.v_WBcm - k.m0.v_WBcm - dt * g_W);
  terms.a_p = k.R_BW * (k.m1.p_WBcm - k.m0.p_WBcm - dt * k.m0.v_WBcm - 0.5 * dt * dt * g_W);
  terms.e_alpha =
      k.m1.w_WB_B - k.m0.w_WB_B + terms.I_inverse * (dt * w.cross(I * w) - dt * k.tau_B);

  Eigen::Matrix<double, N, 1> e = Eigen::Matrix<double, N, 1>::Zero();
  if constexpr (N == 9) {
    if (measurement.form == DynamicsForm::kEuler) {
      e.template head<3>() = m * terms.a_p - 0.5 * dt * dt * k.F_B;
    }
  }
  e.template segment<3>(kVelocityRow<N>) = m * terms.f - dt * k.F_B;
  e.template segment<3>(kAngularRow<N>) = terms.e_alpha;
  if (inertia != nullptr) *inertia = I.diagonal();
  if (J != nullptr) {
    AssembleJacobians(k, RowDerivatives<N>(measurement, k, terms), &J->d_state0, &J->d_state1,
                      &J->d_values);
    J->d_inertia = k.d_body.middleRows<3>(kRowInertia);
  }
  return e;
}

}  // namespace

Eigen::Matrix<double, kNumDynamicsRows, 1> DynamicsResidual(
    const DynamicsMeasurement& measurement, const State& state0, const State& state1,
    const DynamicModel& model, const ModelValues& values, Vector3d* inertia, DynamicsJacobians* J) {
  if (J == nullptr) {
    return EvaluateRows<9>(measurement, state0, state1, model, values, inertia, nullptr);
  }
  Derivatives<9> D;
  auto e = EvaluateRows<9>(measurement, state0, state1, model, values, inertia, &D);
  J->d_state0 = D.d_state0;
  J->d_state1 = D.d_state1;
  J->d_values = D.d_values;
  J->d_inertia = D.d_inertia;
  return e;
}

Eigen::Matrix2d EulerTranslationCovariance(double dt) {
  Eigen::Matrix2d P;
  P << dt * dt * dt * dt / 3.0, dt * dt * dt / 2.0, dt * dt * dt / 2.0, dt * dt;
  return P;
}

RotorRateNoise NoiseOfRotorRates(const DynamicsMeasurement& measurement, double sigma_rad_s2,
                                 const DynamicModel& model, const ModelValues& values,
                                 bool jacobians) {
  RotorRateNoise noise;
  if (jacobians) {
    noise.d_force.setZero(3, values.size());
    noise.d_torque.setZero(3, values.size());
  }
  if (!model.takes_rotor_rates() || sigma_rad_s2 <= 0.0) return noise;
  FlightState still;
  still.rotors = measurement.rotors;
  still.rotors.acceleration.setZero();
  still.rotors.speed_squared_rate.setZero();
  // The wrench is linear in the rates; the torque takes its own thrust coefficient.
  const auto add = [&](const ModelValues& at, int first, Vector3d* variance,
                       ValueJacobian<3>* d_variance) {
    const auto evaluate = [&](const FlightState& state, ModelWrenchJacobians* J) {
      Eigen::Matrix<double, 6, 1> w;
      Vector3d f, tau;
      model.EvaluateWrench(state, at, Vector3d::Zero(), &f, &tau, J);
      w << f, tau;
      return Vector3d(w.segment<3>(first));
    };
    ModelWrenchJacobians J0, J;
    const Vector3d without = evaluate(still, jacobians ? &J0 : nullptr);
    for (int j = 0; j < still.rotors.speed.size(); ++j) {
      FlightState noisy = still;
      noisy.rotors.acceleration[j] = sigma_rad_s2;
      noisy.rotors.speed_squared_rate[j] = 2.0 * still.rotors.speed[j] * sigma_rad_s2;
      const Vector3d change = evaluate(noisy, jacobians ? &J : nullptr) - without;
      *variance += change.cwiseAbs2();
      if (!jacobians) continue;
      *d_variance += 2.0 * change.asDiagonal() *
                     (J.d_values.middleRows<3>(first) - J0.d_values.middleRows<3>(first));
    }
  };
  add(values, 0, &noise.force_variance, &noise.d_force);
  ModelValues anchored = values;
  const int anchor = measurement.anchor_index;
  if (anchor >= 0) anchored[anchor] = measurement.anchor_value;
  add(anchored, 3, &noise.torque_variance, &noise.d_torque);
  if (jacobians && anchor >= 0) noise.d_torque.col(anchor).setZero();
  return noise;
}

void DynamicsFactor::Set(const DynamicsMeasurement& measurement, const DynamicsNoise& noise,
                         bool with_torque, const DynamicModel* model,
                         const ParameterLayout* layout) {
  measurement_ = measurement;
  noise_ = noise;
  with_torque_ = with_torque;
  model_ = model;
  layout_ = layout;
  if (!(measurement.dt > 0.0)) throw std::invalid_argument("DynamicsFactor: dt must be positive");
  set_num_residuals(velocity_row() + 3 + (with_torque ? 3 : 0));
  SetBlockSizes(2, false, *layout, mutable_parameter_block_sizes());
}

bool DynamicsFactor::Evaluate(double const* const* blocks, double* residual,
                              double** jacobians) const {
  return measurement_.form == DynamicsForm::kEuler ? EvaluateForm<9>(blocks, residual, jacobians)
                                                   : EvaluateForm<6>(blocks, residual, jacobians);
}

template <int N>
bool DynamicsFactor::EvaluateForm(double const* const* blocks, double* residual_out,
                                  double** jacobians) const {
  constexpr int v = kVelocityRow<N>, a = kAngularRow<N>;
  const int rows = num_residuals();
  const bool with_values = layout_->num_estimated() > 0;
  const ModelValues values = layout_->Decode(with_values ? blocks[2] : nullptr);
  Derivatives<N> J;
  Vector3d inertia;
  Eigen::Matrix<double, N, 1> e =
      EvaluateRows<N>(measurement_, State::FromBlock(blocks[0]), State::FromBlock(blocks[1]),
                      *model_, values, &inertia, jacobians != nullptr ? &J : nullptr);

  // Whitening: one weight a row; Form E also decorrelates e_v from e_p.
  const double dt = measurement_.dt;
  const bool rated = noise_.rotor_rate_rad_s2 > 0.0 && model_->takes_rotor_rates();
  RotorRateNoise rates;
  if (rated) {
    rates = NoiseOfRotorRates(measurement_, noise_.rotor_rate_rad_s2, *model_, values,
                              jacobians != nullptr);
  }
  const Vector3d rotor_force(0.0, 0.0, noise_.rotor_force_N);
  const Vector3d force_variance =
      noise_.force_N.cwiseAbs2() + rotor_force.cwiseAbs2() + rates.force_variance;
  const Vector3d force_sigma = force_variance.cwiseSqrt();
  Eigen::Matrix<double, N, 1> weight;
  Vector3d torque_variance, d_log_weight_d_inertia;  // the variance in (rad/s²)²
  for (int i = 0; i < 3; ++i) {
    weight[v + i] = 1.0 / (dt * force_sigma[i]);
    const double fixed = noise_.torque_Nm[i] / noise_.nominal_inertia[i];
    const double rotor =
        (noise_.rotor_torque_Nm[i] * noise_.rotor_torque_Nm[i] + rates.torque_variance[i]) /
        (inertia[i] * inertia[i]);
    torque_variance[i] = fixed * fixed + rotor;
    weight[a + i] = 1.0 / (dt * std::sqrt(torque_variance[i]));
    d_log_weight_d_inertia[i] = rotor / (torque_variance[i] * inertia[i]);
  }
  Eigen::Matrix2d sqrt_info;
  if constexpr (N == 9) {
    sqrt_info = EulerTranslationCovariance(dt).llt().matrixL().solve(Eigen::Matrix2d::Identity());
  }
  const auto whiten = [&](auto* m) {
    m->template bottomRows<3>() =
        weight.template tail<3>().asDiagonal() * m->template bottomRows<3>();
    if constexpr (N == 9) {
      const auto scale = force_sigma.cwiseInverse().asDiagonal();
      m->template middleRows<3>(v) = (scale * (sqrt_info(1, 0) * m->template topRows<3>() +
                                               sqrt_info(1, 1) * m->template middleRows<3>(v)))
                                         .eval();
      m->template topRows<3>() = (scale * (sqrt_info(0, 0) * m->template topRows<3>())).eval();
    } else {
      m->template topRows<3>() = weight.template head<3>().asDiagonal() * m->template topRows<3>();
    }
  };
  whiten(&e);
  Eigen::Map<Eigen::VectorXd>(residual_out, rows) = e.head(rows);
  if (jacobians == nullptr) return e.allFinite();
  for (int k = 0; k < 2; ++k) {
    if (jacobians[k] == nullptr) continue;
    auto& d_state = k == 0 ? J.d_state0 : J.d_state1;
    whiten(&d_state);
    WriteJacobian(StateManifold::Lift(d_state, blocks[k]).topRows(rows), jacobians[k]);
  }
  if (!with_values || jacobians[2] == nullptr) return e.allFinite();
  whiten(&J.d_values);
  // The weights depend on the live inertia, and on coefficients of rotor rates.
  for (int i = 0; i < 3; ++i) {
    J.d_values.row(a + i) += e[a + i] * d_log_weight_d_inertia[i] * J.d_inertia.row(i);
    if (!rated) continue;
    const double by_torque = -0.5 / (torque_variance[i] * inertia[i] * inertia[i]);
    J.d_values.row(a + i) += e[a + i] * by_torque * rates.d_torque.row(i);
    const double by_force = -0.5 / force_variance[i];
    J.d_values.row(v + i) += e[v + i] * by_force * rates.d_force.row(i);
    if constexpr (N == 9) J.d_values.row(i) += e[i] * by_force * rates.d_force.row(i);
  }
  const ValueJacobian<Eigen::Dynamic> kept = J.d_values.topRows(rows);
  WriteParameterJacobian<Eigen::Dynamic>(*layout_, values, kept, jacobians[2]);
  return e.allFinite();
}

bool DynamicsFactor::UnwhitenedResidual(double const* const* blocks,
                                        Eigen::Matrix<double, kNumDynamicsRows, 1>* e) const {
  *e = DynamicsResidual(measurement_, State::FromBlock(blocks[0]), State::FromBlock(blocks[1]),
                        *model_,
                        layout_->Decode(layout_->num_estimated() > 0 ? blocks[2] : nullptr));
  return e->allFinite();
}

void SetBlockSizes(int states, bool bias, const ParameterLayout& layout,
                   std::vector<int32_t>* sizes) {
  sizes->assign(static_cast<size_t>(states), kStateSize);
  if (bias) sizes->push_back(6);
  if (layout.num_estimated() > 0) sizes->push_back(layout.num_estimated());
}

}  // namespace odmc
