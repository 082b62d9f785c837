#include "odmc/factors/manifolds.h"

#include <Eigen/Geometry>

#include "odmc/factors/state.h"
#include "odmc/math/so3.h"

namespace odmc {
namespace {

/// d(q Exp(theta)) / d theta at theta = 0 for q = (x, y, z, w) (4×3).
///                                                             model.md section 7, Eq. (M24)
Eigen::Matrix<double, 4, 3> PlusDerivative(const double* q) {
  Eigen::Matrix<double, 4, 3> P;
  P << q[3], -q[2], q[1], q[2], q[3], -q[0], -q[1], q[0], q[3], -q[0], -q[1], -q[2];
  return 0.5 * P;
}

}  // namespace

State State::FromBlock(const double* block) {
  State s;
  s.p_WS = Eigen::Map<const Eigen::Vector3d>(block);
  s.q_WS = Eigen::Map<const Eigen::Quaterniond>(block + 3);
  s.v_WS = Eigen::Map<const Eigen::Vector3d>(block + 7);
  s.w_WS_S = Eigen::Map<const Eigen::Vector3d>(block + 10);
  return s;
}

void State::ToBlock(double* block) const {
  Eigen::Map<Eigen::Vector3d>(block + 0) = p_WS;
  Eigen::Map<Eigen::Quaterniond>(block + 3) = q_WS;
  Eigen::Map<Eigen::Vector3d>(block + 7) = v_WS;
  Eigen::Map<Eigen::Vector3d>(block + 10) = w_WS_S;
}

Eigen::Matrix<double, 3, 4> RotationManifold::Lift(const double* x) {
  return 4.0 * PlusDerivative(x).transpose();
}

bool RotationManifold::Plus(const double* x, const double* delta, double* x_plus_delta) const {
  const Eigen::Map<const Eigen::Quaterniond> q(x);
  const Eigen::Map<const Eigen::Vector3d> theta(delta);
  Eigen::Map<Eigen::Quaterniond> result(x_plus_delta);
  result = (q * Exp(theta)).normalized();
  return true;
}

bool RotationManifold::PlusJacobian(const double* x, double* jacobian) const {
  WriteJacobian(PlusDerivative(x), jacobian);
  return true;
}

bool RotationManifold::Minus(const double* y, const double* x, double* y_minus_x) const {
  const Eigen::Map<const Eigen::Quaterniond> qy(y), qx(x);
  Eigen::Map<Eigen::Vector3d> theta(y_minus_x);
  theta = Log(qx.conjugate() * qy);
  return true;
}

bool RotationManifold::MinusJacobian(const double* x, double* jacobian) const {
  WriteJacobian(Lift(x), jacobian);
  return true;
}

bool StateManifold::Plus(const double* x, const double* delta, double* x_plus_delta) const {
  for (int i = 0; i < 3; ++i) x_plus_delta[i] = x[i] + delta[i];
  for (int i = 0; i < 6; ++i) x_plus_delta[7 + i] = x[7 + i] + delta[6 + i];
  return RotationManifold().Plus(x + 3, delta + 3, x_plus_delta + 3);
}

bool StateManifold::PlusJacobian(const double* x, double* jacobian) const {
  Eigen::Matrix<double, 13, 12> J = Eigen::Matrix<double, 13, 12>::Zero();
  J.block<3, 3>(0, 0).setIdentity();
  J.block<4, 3>(3, 3) = PlusDerivative(x + 3);
  J.block<6, 6>(7, 6).setIdentity();
  WriteJacobian(J, jacobian);
  return true;
}

bool StateManifold::Minus(const double* y, const double* x, double* y_minus_x) const {
  for (int i = 0; i < 3; ++i) y_minus_x[i] = y[i] - x[i];
  for (int i = 0; i < 6; ++i) y_minus_x[6 + i] = y[7 + i] - x[7 + i];
  return RotationManifold().Minus(y + 3, x + 3, y_minus_x + 3);
}

bool StateManifold::MinusJacobian(const double* x, double* jacobian) const {
  Eigen::Matrix<double, 12, 12> identity = Eigen::Matrix<double, 12, 12>::Identity();
  WriteJacobian(Lift(identity, x), jacobian);
  return true;
}

}  // namespace odmc
