#include "odmc/factors/dynamics_factor.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <cmath>
#include <numeric>
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

/// The torque equation with one inertia.
struct Rotation {
  Matrix3d I, I_inverse;
  Vector3d e_alpha;

  Rotation() = default;
  Rotation(const Matrix3d& inertia, const IntervalModel& k, double dt) : I(inertia) {
    const Vector3d& w = k.flight.w_WB_B;
    I_inverse = I.inverse();
    e_alpha = k.m1.w_WB_B - k.m0.w_WB_B + I_inverse * (dt * w.cross(I * w) - dt * k.tau_B);
  }
};

/// What the residual is made of, besides the interval's model.
struct Terms {
  Vector3d f, a_p;
  double nominal_mass, per_mass;  ///< of the vehicle file [kg]; over that of the values
  /// With the inertia of the values, and with that of some axes held; those that no row takes are
  /// not set.
  Rotation free, held;
  std::array<bool, 3> is_held;

  const Rotation& of_row(int i) const { return is_held[i] ? held : free; }
  bool any(bool held_ones) const {
    return is_held[0] == held_ones || is_held[1] == held_ones || is_held[2] == held_ones;
  }
};

/// The residual's rows (9 with e_p, 6 without).
template <int N>
Eigen::Matrix<double, N, 1> EvaluateRows(const DynamicsMeasurement& measurement,
                                         const IntervalModel& k, Terms* terms) {
  const double dt = measurement.dt;
  const Vector3d& g_W = k.body.g_W;
  terms->nominal_mass = k.model->vehicle().mass_kg;
  terms->per_mass = terms->nominal_mass / k.body.mass;
  terms->f = k.R_BW * (k.m1.v_WBcm - k.m0.v_WBcm - dt * g_W);
  terms->is_held = measurement.inertia_fixed;
  if (terms->any(false)) terms->free = Rotation(k.body.I_BBcm_B, k, dt);
  if (terms->any(true)) {
    Matrix3d I = k.body.I_BBcm_B;
    for (int i = 0; i < 3; ++i) {
      if (terms->is_held[i]) I(i, i) = measurement.fixed_inertia[i];
    }
    terms->held = Rotation(I, k, dt);
  }
  Eigen::Matrix<double, N, 1> e;
  if constexpr (N == 9) {
    e.template head<3>().setZero();
    if (measurement.form == DynamicsForm::kEuler) {
      terms->a_p = k.R_BW * (k.m1.p_WBcm - k.m0.p_WBcm - dt * k.m0.v_WBcm - 0.5 * dt * dt * g_W);
      e.template head<3>() =
          terms->nominal_mass * terms->a_p - 0.5 * dt * dt * terms->per_mass * k.F_B;
    }
  }
  e.template segment<3>(kVelocityRow<N>) =
      terms->nominal_mass * terms->f - dt * terms->per_mass * k.F_B;
  for (int i = 0; i < 3; ++i) e[kAngularRow<N> + i] = terms->of_row(i).e_alpha[i];
  return e;
}

/// Those of the torque equation whose axes are held, or free.
template <int N>
void SetRotationRows(const IntervalModel& k, const Terms& terms, bool held, double dt, int first,
                     IntervalDerivatives<N>* D) {
  const Rotation& r = held ? terms.held : terms.free;
  const Vector3d& w = k.flight.w_WB_B;
  const Vector3d dw = k.m1.w_WB_B - k.m0.w_WB_B;
  const Matrix3d by_rate = dt * r.I_inverse * (HatTimes(w, r.I) - Hat(r.I * w));
  Eigen::Matrix<double, 3, 6> by_inertia =
      r.I_inverse *
      (InertiaProductDerivative(dw - r.e_alpha) + HatTimes(dt * w, InertiaProductDerivative(w)));
  for (int i = 0; held && i < 3; ++i) {
    if (terms.is_held[i]) by_inertia.col(i).setZero();
  }
  for (int i = 0; i < 3; ++i) {
    if (terms.is_held[i] != held) continue;
    D->d_wrench().template block<1, 3>(first + i, 3) = -dt * r.I_inverse.row(i);
    D->d_rate().row(first + i) = by_rate.row(i);
    D->d_body().template block<1, 6>(first + i, kRowInertia) = by_inertia.row(i);
  }
}

/// Derivatives of the rows with respect to the interval's pieces.                model.md section 6
template <int N>
IntervalDerivatives<N> RowDerivatives(const DynamicsMeasurement& measurement,
                                      const IntervalModel& k, const Terms& terms) {
  constexpr int v = kVelocityRow<N>, a = kAngularRow<N>;
  const double dt = measurement.dt;
  const double m = terms.nominal_mass, per_mass = terms.per_mass;
  using Columns = IntervalDerivatives<N>;
  IntervalDerivatives<N> D;
  auto d_wrench = D.d_wrench();
  auto d_motion0 = D.d_motion0(), d_motion1 = D.d_motion1();
  auto d_body = D.d_body();
  const auto set = [](int row, int column, double x, auto* d) {  // x times identity
    for (int i = 0; i < 3; ++i) (*d)(row + i, column + i) = x;
  };
  set(v, 0, -dt * per_mass, &d_wrench);
  D.d_theta().template middleRows<3>(v) = m * Hat(terms.f);
  set(v, Columns::kComVelocity, -m, &d_motion0);
  set(v, Columns::kComVelocity, m, &d_motion1);
  set(a, Columns::kRate, -1.0, &d_motion0);
  set(a, Columns::kRate, 1.0, &d_motion1);
  d_body.template block<3, 1>(v, kRowMass) = (dt * per_mass / k.body.mass) * k.F_B;
  d_body.template block<3, 3>(v, kRowGravity) = -dt * m * k.R_BW;
  for (const bool held : {false, true}) {
    if (terms.any(held)) SetRotationRows(k, terms, held, dt, a, &D);
  }
  if constexpr (N == 9) {
    if (measurement.form == DynamicsForm::kEuler) {
      set(0, 0, -0.5 * dt * dt * per_mass, &d_wrench);
      D.d_theta().template middleRows<3>(0) = m * Hat(terms.a_p);
      set(0, Columns::kComPosition, -m, &d_motion0);
      set(0, Columns::kComPosition, m, &d_motion1);
      set(0, Columns::kComVelocity, -dt * m, &d_motion0);
      D.by_position = true;
      d_body.template block<3, 1>(0, kRowMass) = (0.5 * dt * dt * per_mass / k.body.mass) * k.F_B;
      d_body.template block<3, 3>(0, kRowGravity) = -0.5 * dt * dt * m * k.R_BW;
    }
  }
  return D;
}

}  // namespace

Eigen::Matrix<double, kNumDynamicsRows, 1> DynamicsResidual(
    const DynamicsMeasurement& measurement, const State& state0, const State& state1,
    const DynamicModel& model, const ModelValues& values, Vector3d* inertia, DynamicsJacobians* J) {
  const IntervalModel k(measurement, state0, state1, model, values, true, J != nullptr);
  Terms terms;
  const auto e = EvaluateRows<kNumDynamicsRows>(measurement, k, &terms);
  for (int i = 0; inertia != nullptr && i < 3; ++i) (*inertia)[i] = terms.of_row(i).I(i, i);
  if (J != nullptr) {
    auto D = RowDerivatives<kNumDynamicsRows>(measurement, k, terms);
    std::vector<int> all(model.num_parameters());
    std::iota(all.begin(), all.end(), 0);
    AssembleJacobians(k, all, &D, &J->d_state0, &J->d_state1, &J->d_values);
    J->d_inertia.setZero(3, model.num_parameters());
    for (const int c : all) {
      const BodyPropertyRows& rows = model.shaped_rows(c);
      for (int i = 0; i < 3; ++i) {
        const int row = kRowInertia + i;
        if (row >= rows.first && row < rows.first + rows.count && !measurement.inertia_fixed[i])
          J->d_inertia(i, c) = k.d_body(row, c);
      }
    }
  }
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
  const TorqueAnchor anchor = {measurement.anchor_index, measurement.anchor_value};
  const auto evaluate = [&](const FlightState& state, Vector3d* f, Vector3d* tau,
                            ModelWrenchJacobians* J) {
    model.EvaluateRateEffects(state, values, Vector3d::Zero(), f, tau, jacobians ? J : nullptr,
                              anchor.index >= 0 ? &anchor : nullptr);
  };
  // The wrench is linear in the rates: what one rotor's change is the difference.
  ModelWrenchJacobians J0, J;
  Vector3d f0, tau0, f, tau;
  evaluate(still, &f0, &tau0, &J0);
  FlightState noisy = still;
  for (int j = 0; j < still.rotors.speed.size(); ++j) {
    noisy.rotors.acceleration[j] = sigma_rad_s2;
    noisy.rotors.speed_squared_rate[j] = 2.0 * still.rotors.speed[j] * sigma_rad_s2;
    evaluate(noisy, &f, &tau, &J);
    noisy.rotors.acceleration[j] = noisy.rotors.speed_squared_rate[j] = 0.0;
    f -= f0;
    tau -= tau0;
    noise.force_variance += f.cwiseAbs2();
    noise.torque_variance += tau.cwiseAbs2();
    if (!jacobians) continue;
    const auto change = J.d_values - J0.d_values;
    noise.d_force += (2.0 * f).asDiagonal() * change.topRows<3>();
    noise.d_torque += (2.0 * tau).asDiagonal() * change.bottomRows<3>();
  }
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
  anchor_entry_ = measurement.anchor_index < 0 ? -1 : layout->EntryOf(measurement.anchor_index);
  if (anchor_entry_ >= 0) mutable_parameter_block_sizes()->push_back(1);
}

DynamicsMeasurement DynamicsFactor::AnchoredAt(double const* const* blocks) const {
  DynamicsMeasurement anchored = measurement_;
  anchored.anchor_value = layout_->ToValue(anchor_entry_, *blocks[3]);
  return anchored;
}

bool DynamicsFactor::Evaluate(double const* const* blocks, double* residual,
                              double** jacobians) const {
  return measurement_.form == DynamicsForm::kEuler ? EvaluateForm<9>(blocks, residual, jacobians)
                                                   : EvaluateForm<6>(blocks, residual, jacobians);
}

namespace {

/// What whitens the rows: one weight each; Form E also decorrelates e_v from e_p.
template <int N>
struct Whitening {
  Vector3d inertia;                          // each row's own
  Vector3d force_variance, torque_variance;  // the latter in (rad/s²)²
  Vector3d force_sigma;
  Vector3d d_log_weight_d_inertia;  // of the angular rows
  Eigen::Matrix<double, N, 1> weight;
  Eigen::Matrix2d sqrt_info;  // of e_p and e_v

  Whitening(const DynamicsNoise& noise, const RotorRateNoise& rates, const Terms& terms,
            double dt) {
    constexpr int v = kVelocityRow<N>, a = kAngularRow<N>;
    for (int i = 0; i < 3; ++i) inertia[i] = terms.of_row(i).I(i, i);
    const Vector3d rotor_force(0.0, 0.0, noise.rotor_force_N);
    force_variance = noise.force_N.cwiseAbs2() + rotor_force.cwiseAbs2() + rates.force_variance;
    force_sigma = force_variance.cwiseSqrt();
    for (int i = 0; i < 3; ++i) {
      weight[v + i] = 1.0 / (dt * force_sigma[i]);
      const double fixed = noise.torque_Nm[i] / noise.nominal_inertia[i];
      const double rotor =
          (noise.rotor_torque_Nm[i] * noise.rotor_torque_Nm[i] + rates.torque_variance[i]) /
          (inertia[i] * inertia[i]);
      torque_variance[i] = fixed * fixed + rotor;
      weight[a + i] = 1.0 / (dt * std::sqrt(torque_variance[i]));
      d_log_weight_d_inertia[i] =
          terms.is_held[i] ? 0.0 : rotor / (torque_variance[i] * inertia[i]);
    }
    if constexpr (N == 9) {
      sqrt_info = EulerTranslationCovariance(dt).llt().matrixL().solve(Eigen::Matrix2d::Identity());
    }
  }

  /// Whitens a column, or each of several.
  template <typename Columns>
  void Apply(Columns* m) const {
    if constexpr (N == 9) {
      const auto scale = force_sigma.cwiseInverse().asDiagonal();
      for (int c = 0; c < m->cols(); ++c) {
        auto e_p = m->col(c).template head<3>();
        auto e_v = m->col(c).template segment<3>(kVelocityRow<N>);
        e_v = scale * (sqrt_info(1, 0) * e_p + sqrt_info(1, 1) * e_v);
        e_p = scale * (sqrt_info(0, 0) * e_p);
        m->col(c).template tail<3>().array() *= weight.template tail<3>().array();
      }
    } else {
      for (int c = 0; c < m->cols(); ++c) m->col(c).array() *= weight.array();
    }
  }
};

/// The weights depend on coefficients of rotor rates, too.
/// @param e whitened residual
template <int N>
void AddWeightDerivatives(const Whitening<N>& whitening, const RotorRateNoise& rates,
                          const Eigen::Matrix<double, N, 1>& e, const ParameterLayout& layout,
                          ValueJacobian<N>* d_values) {
  constexpr int v = kVelocityRow<N>, a = kAngularRow<N>;
  for (int i = 0; i < 3; ++i) {
    const double inertia = whitening.inertia[i];
    const double by_torque = -0.5 / (whitening.torque_variance[i] * inertia * inertia);
    const double by_force = -0.5 / whitening.force_variance[i];
    for (int c = 0; c < layout.num_estimated(); ++c) {
      const int value = layout.model_index(c);
      (*d_values)(a + i, c) += e[a + i] * by_torque * rates.d_torque(i, value);
      (*d_values)(v + i, c) += e[v + i] * by_force * rates.d_force(i, value);
      if constexpr (N == 9) (*d_values)(i, c) += e[i] * by_force * rates.d_force(i, value);
    }
  }
}

}  // namespace

template <int N>
bool DynamicsFactor::EvaluateForm(double const* const* blocks, double* residual_out,
                                  double** jacobians) const {
  constexpr int a = kAngularRow<N>;
  const int rows = num_residuals();
  const bool with_values = layout_->num_estimated() > 0;
  const ModelValues values = layout_->Decode(with_values ? blocks[2] : nullptr);
  const DynamicsMeasurement anchored =
      anchor_entry_ >= 0 ? AnchoredAt(blocks) : DynamicsMeasurement();
  const DynamicsMeasurement& measurement = anchor_entry_ >= 0 ? anchored : measurement_;
  const IntervalModel k(measurement, State::FromBlock(blocks[0]), State::FromBlock(blocks[1]),
                        *model_, values, with_torque_, jacobians != nullptr);
  Terms terms;
  Eigen::Matrix<double, N, 1> e = EvaluateRows<N>(measurement, k, &terms);

  const bool rated = noise_.rotor_rate_rad_s2 > 0.0 && model_->takes_rotor_rates();
  RotorRateNoise rates;
  if (rated) {
    rates = NoiseOfRotorRates(measurement, noise_.rotor_rate_rad_s2, *model_, values,
                              jacobians != nullptr);
  }
  const Whitening<N> whitening(noise_, rates, terms, measurement.dt);
  // The weights depend on the live inertia: as if e_alpha did.
  const Vector3d by_inertia = e.template tail<3>().cwiseProduct(whitening.d_log_weight_d_inertia);
  whitening.Apply(&e);
  Eigen::Map<Eigen::VectorXd>(residual_out, rows) = e.head(rows);
  if (jacobians == nullptr) return e.allFinite();
  IntervalDerivatives<N> D = RowDerivatives<N>(measurement, k, terms);
  for (int i = 0; i < 3; ++i) D.d_body()(a + i, kRowInertia + i) += by_inertia[i];
  Eigen::Matrix<double, N, kStateTangentSize> d_state0, d_state1;
  ValueJacobian<N> d_values;
  const bool by_state0 = jacobians[0] != nullptr, by_state1 = jacobians[1] != nullptr;
  AssembleJacobians(k, layout_->model_indices(), &D, by_state0 ? &d_state0 : nullptr,
                    by_state1 ? &d_state1 : nullptr, &d_values);
  if (anchor_entry_ >= 0 && jacobians[3] != nullptr) {
    const double chain = layout_->ChainFactor(anchor_entry_, measurement.anchor_value);
    const Vector3d d_tau = -measurement.dt * chain * k.d_wrench.d_anchor;
    std::fill_n(jacobians[3], rows, 0.0);
    for (int i = 0; i < (with_torque_ ? 3 : 0); ++i) {
      jacobians[3][rows - 3 + i] =
          whitening.weight[a + i] * terms.of_row(i).I_inverse.row(i).dot(d_tau);
    }
  }
  if (by_state0) {
    whitening.Apply(&d_state0);
    WriteStateJacobian<N>(d_state0, rows, blocks[0], jacobians[0]);
  }
  if (by_state1) {
    whitening.Apply(&d_state1);
    WriteStateJacobian<N>(d_state1, rows, blocks[1], jacobians[1]);
  }
  if (!with_values || jacobians[2] == nullptr) return e.allFinite();
  whitening.Apply(&d_values);
  if (rated) AddWeightDerivatives<N>(whitening, rates, e, *layout_, &d_values);
  WriteParameterJacobian<N>(*layout_, values, d_values, rows, jacobians[2]);
  return e.allFinite();
}

bool DynamicsFactor::UnwhitenedResidual(double const* const* blocks,
                                        Eigen::Matrix<double, kNumDynamicsRows, 1>* e) const {
  *e = DynamicsResidual(anchor_entry_ >= 0 ? AnchoredAt(blocks) : measurement_,
                        State::FromBlock(blocks[0]), State::FromBlock(blocks[1]), *model_,
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
