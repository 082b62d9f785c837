#include "odmc/factors/imu_factors.h"

#include <limits>

#include "odmc/factors/dynamics_factor.h"
#include "odmc/factors/manifolds.h"
#include "odmc/math/so3.h"

namespace odmc {

using Eigen::Matrix3d;
using Eigen::Vector3d;

namespace {

using StateBlock = Eigen::Matrix<double, 3, kStateTangentSize>;
using BiasBlock = Eigen::Matrix<double, 3, kBiasSize>;

/// The eta block, or null where nothing is estimated and there is none.
const double* Eta(const ParameterLayout& layout, double const* const* block) {
  return layout.num_estimated() > 0 ? block[0] : nullptr;
}

/// The body at `values`, for the mounts; their derivatives where they have any.
BodyProperties Mounts(const DynamicModel& model, const ModelValues& values, bool jacobians,
                      BodyPropertiesJacobian* d_body) {
  return model.ShapedProperties(values, std::numeric_limits<double>::infinity(),
                                jacobians && model.shapes_mounts() ? d_body : nullptr);
}

/// Writes the derivatives by eta of a residual that depends only on the mounts of the body.
void WriteMount(const DynamicModel& model, const ParameterLayout& layout, const ModelValues& values,
                const Eigen::Matrix<double, 3, kNumBodyPropertyRows>& d_body_rows,
                const BodyPropertiesJacobian& d_body, double** jacobians) {
  if (layout.num_estimated() == 0 || jacobians[0] == nullptr) return;
  ValueJacobian<3> d_values;
  d_values.setZero(3, layout.num_estimated());
  for (int i = 0; i < (model.shapes_mounts() ? layout.num_estimated() : 0); ++i) {
    auto column = d_values.col(i);
    AddBodyColumn<3>(model, d_body, d_body_rows, layout.model_index(i), &column);
  }
  WriteParameterJacobian<3>(layout, values, d_values, 3, jacobians[0]);
}

}  // namespace

void GyroPreintegrationFactor::Set(const ImuInterval& interval, const ImuNoise& noise,
                                   const DynamicModel* model, const ParameterLayout* layout) {
  interval_ = interval;
  noise_ = noise;
  model_ = model;
  layout_ = layout;
  set_num_residuals(3);
  SetBlockSizes(2, true, *layout, mutable_parameter_block_sizes());
}

bool GyroPreintegrationFactor::Evaluate(double const* const* blocks, double* residual,
                                        double** jacobians) const {
  const State s0 = State::FromBlock(blocks[0]), s1 = State::FromBlock(blocks[1]);
  const Vector3d bias = Eigen::Map<const Vector3d>(blocks[2]);
  const ModelValues values = layout_->Decode(Eta(*layout_, blocks + 3));
  BodyPropertiesJacobian d_body;
  const BodyProperties body = Mounts(*model_, values, jacobians != nullptr, &d_body);
  const Matrix3d R_SI = body.R_BS.transpose() * body.R_BI;
  const Vector3d correction = interval_.d_bias * (bias - interval_.bias_lin);
  // The same turn seen from I has the same cosine and the axis in I.
  Eigen::Quaterniond q_I0I1 = s0.q_WS.conjugate() * s1.q_WS;
  q_I0I1.vec() = (R_SI.transpose() * q_I0I1.vec()).eval();
  const Eigen::Quaterniond error = (interval_.delta_q * Exp(correction)).conjugate() * q_I0I1;
  Matrix3d J_r;
  const Vector3d e = Log(error, &J_r);
  const double weight = 1.0 / noise_.preintegration_rad;
  Eigen::Map<Vector3d>(residual + 0) = weight * e;
  if (jacobians == nullptr) return e.allFinite();

  // error = ... Exp: right perturbations of R_WI1 enter as they are, those of R_WI0 through R_I1I0.
  const Matrix3d d_theta_I1 = weight * J_r;
  const Matrix3d d_theta_I0 = -d_theta_I1 * q_I0I1.toRotationMatrix().transpose();
  const Matrix3d d_bias = -d_theta_I1 * error.toRotationMatrix().transpose() *
                          (RightJacobian(correction) * interval_.d_bias);
  // R_WI = R_WS R_BSᵀ R_BI: theta_I = R_SIᵀ theta_S - R_BIᵀ R_BS theta_BS + theta_BI.
  StateBlock J0 = StateBlock::Zero(), J1 = StateBlock::Zero();
  J0.middleCols<3>(kTangentRotation) = d_theta_I0 * R_SI.transpose();
  J1.middleCols<3>(kTangentRotation) = d_theta_I1 * R_SI.transpose();
  WriteStateJacobian<3>(J0, 3, blocks[0], jacobians[0]);
  WriteStateJacobian<3>(J1, 3, blocks[1], jacobians[1]);
  BiasBlock J_bias = BiasBlock::Zero();
  J_bias.leftCols<3>() = d_bias;
  WriteJacobian(J_bias, jacobians[2]);
  Eigen::Matrix<double, 3, kNumBodyPropertyRows> rows;
  rows.setZero();
  rows.middleCols<3>(kRowOdometryRotation) = -(J0 + J1).middleCols<3>(kTangentRotation);
  rows.middleCols<3>(kRowImuRotation) = d_theta_I0 + d_theta_I1;
  WriteMount(*model_, *layout_, values, rows, d_body, jacobians + 3);
  return e.allFinite();
}

void GyroFactor::Set(const Eigen::Vector3d& gyro_I, const ImuNoise& noise,
                     const DynamicModel* model, const ParameterLayout* layout) {
  gyro_I_ = gyro_I;
  noise_ = noise;
  model_ = model;
  layout_ = layout;
  set_num_residuals(3);
  SetBlockSizes(1, true, *layout, mutable_parameter_block_sizes());
}

bool GyroFactor::Evaluate(double const* const* blocks, double* residual, double** jacobians) const {
  const State state = State::FromBlock(blocks[0]);
  const Vector3d bias = Eigen::Map<const Vector3d>(blocks[1]);
  const ModelValues values = layout_->Decode(Eta(*layout_, blocks + 2));
  BodyPropertiesJacobian d_body;
  const BodyProperties body = Mounts(*model_, values, jacobians != nullptr, &d_body);
  const Matrix3d R_IB = body.R_BI.transpose();
  const Vector3d w_B = body.R_BS * state.w_WS_S;
  const double weight = 1.0 / noise_.gyro_rad_s;
  const Vector3d e = R_IB * w_B + bias - gyro_I_;
  Eigen::Map<Vector3d>(residual + 0) = weight * e;
  if (jacobians == nullptr) return e.allFinite();

  StateBlock J = StateBlock::Zero();
  J.middleCols<3>(kTangentRate) = weight * R_IB * body.R_BS;
  WriteStateJacobian<3>(J, 3, blocks[0], jacobians[0]);
  BiasBlock J_bias = BiasBlock::Zero();
  J_bias.leftCols<3>().diagonal().setConstant(weight);
  WriteJacobian(J_bias, jacobians[1]);
  Eigen::Matrix<double, 3, kNumBodyPropertyRows> rows;
  rows.setZero();
  rows.middleCols<3>(kRowOdometryRotation) = -TimesHat(J.middleCols<3>(kTangentRate), state.w_WS_S);
  rows.middleCols<3>(kRowImuRotation) = weight * Hat(R_IB * w_B);
  WriteMount(*model_, *layout_, values, rows, d_body, jacobians + 2);
  return e.allFinite();
}

void AccelerometerFactor::Set(const DynamicsMeasurement& measurement,
                              const Eigen::Vector3d& specific_force_I, const Eigen::Vector3d& sigma,
                              const DynamicModel* model, const ParameterLayout* layout) {
  measurement_ = measurement;
  specific_force_I_ = specific_force_I;
  sigma_ = sigma;
  model_ = model;
  layout_ = layout;
  set_num_residuals(3);
  SetBlockSizes(2, true, *layout, mutable_parameter_block_sizes());
}

bool AccelerometerFactor::Evaluate(double const* const* blocks, double* residual,
                                   double** jacobians) const {
  const Vector3d bias = Eigen::Map<const Vector3d>(blocks[2] + 3);
  const ModelValues values = layout_->Decode(Eta(*layout_, blocks + 3));
  const IntervalModel k(measurement_, State::FromBlock(blocks[0]), State::FromBlock(blocks[1]),
                        *model_, values, false, jacobians != nullptr);
  const double dt = measurement_.dt;
  const Matrix3d R_IB = k.body.R_BI.transpose();
  const Vector3d r = k.body.p_BBcm - k.body.p_BI;
  const Vector3d& w = k.flight.w_WB_B;
  const Vector3d w_dot = (k.m1.w_WB_B - k.m0.w_WB_B) / dt;
  const Vector3d a_B = k.F_B / k.body.mass - w_dot.cross(r) - w.cross(w.cross(r));
  const Vector3d e = R_IB * a_B + bias - specific_force_I_;
  Eigen::Map<Vector3d>(residual + 0) = e.cwiseQuotient(sigma_);
  if (jacobians == nullptr) return e.allFinite();

  const auto W = sigma_.cwiseInverse().asDiagonal();
  const Matrix3d WR = W * R_IB;
  const Matrix3d WR_r = TimesHat(WR, r), WR_w = TimesHat(WR, w);
  IntervalDerivatives<3> D;
  D.d_wrench().leftCols<3>() = WR / k.body.mass;
  D.d_rate() = TimesHat(WR, w.cross(r)) + TimesHat(WR_w, r);
  D.d_motion0().middleCols<3>(D.kRate) = -WR_r / dt;
  D.d_motion1().middleCols<3>(D.kRate) = WR_r / dt;
  const Matrix3d d_r = -TimesHat(WR, w_dot) - TimesHat(WR_w, w);
  D.d_body().middleCols<3>(kRowImuPosition) = -d_r;
  D.d_body().middleCols<3>(kRowCom) = d_r;
  D.d_body().middleCols<3>(kRowImuRotation) = W * Hat(R_IB * a_B);
  D.d_body().col(kRowMass) = -WR * k.F_B / (k.body.mass * k.body.mass);
  StateBlock J0, J1;
  ValueJacobian<3> d_values;
  AssembleJacobians(k, layout_->model_indices(), &D, &J0, &J1, &d_values);
  WriteStateJacobian<3>(J0, 3, blocks[0], jacobians[0]);
  WriteStateJacobian<3>(J1, 3, blocks[1], jacobians[1]);
  BiasBlock J_bias = BiasBlock::Zero();
  J_bias.rightCols<3>() = W;
  WriteJacobian(J_bias, jacobians[2]);
  if (layout_->num_estimated() > 0) {
    WriteParameterJacobian<3>(*layout_, values, d_values, 3, jacobians[3]);
  }
  return e.allFinite();
}

}  // namespace odmc
