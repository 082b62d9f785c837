#include "odmc/estimator/gates.h"

#include <Eigen/Cholesky>
#include <algorithm>

namespace odmc {
namespace {

constexpr double kBlock_s = 0.05;
constexpr double kEnough_s = 1.0;  // of flight before the gate may open

}  // namespace

Eigen::Vector3d RotorTorqueDirection(const Vehicle& vehicle, const RotorVector& speed_squared) {
  Eigen::Vector3d torque = Eigen::Vector3d::Zero();
  for (int j = 0; j < vehicle.num_rotors(); ++j) {
    const Rotor& rotor = vehicle.rotors[j];
    torque += speed_squared[j] * Eigen::Vector3d(rotor.p_BP.y(), -rotor.p_BP.x(), rotor.spin);
  }
  return torque;
}

InertiaGate::InertiaGate(double min_r_squared) : min_r_squared_(min_r_squared) { Break(); }

void InertiaGate::Restore(const Statistics& before) {
  seen_ = before;
  Break();
}

void InertiaGate::Break() {
  block_s_ = 0.0;
  torque_sum_.setZero();
  rate_sum_.setZero();
  thrust_sum_ = 0.0;
}

void InertiaGate::Add(double dt, const Eigen::Vector3d& w0, const Eigen::Vector3d& w1,
                      const Eigen::Vector3d& torque, double speed_squared) {
  if (block_s_ == 0.0) first_w_ = w0;
  last_w_ = w1;
  torque_sum_ += dt * torque;
  rate_sum_ += 0.5 * dt * (w0 + w1);
  thrust_sum_ += dt * speed_squared;
  block_s_ += dt;
  if (block_s_ >= kBlock_s) CloseBlock();
}

void InertiaGate::CloseBlock() {
  seen_.time_s += block_s_;
  for (int axis = 0; axis < 3; ++axis) {
    const Eigen::Vector4d z(last_w_[axis] - first_w_[axis], torque_sum_[axis], rate_sum_[axis],
                            thrust_sum_);
    seen_.gram[axis] += z * z.transpose();
    // Two thresholds keep it from flapping.
    const double r_squared = RSquared(axis);
    const double threshold = seen_.open[axis] ? 0.8 * min_r_squared_ : min_r_squared_;
    seen_.open[axis] = seen_.time_s >= kEnough_s && r_squared > threshold;
  }
  Break();
}

double InertiaRSquared(const Eigen::Matrix4d& G) {
  // Residual second moments of (acceleration, torque) after regression on (rate, thrust).
  Eigen::Vector4d scale = G.diagonal().cwiseSqrt();
  if (scale[0] <= 0.0 || scale[1] <= 0.0) return 0.0;
  scale = scale.cwiseMax(1e-300).cwiseInverse();
  const Eigen::Matrix4d C = scale.asDiagonal() * G * scale.asDiagonal();
  Eigen::Matrix2d given = C.bottomRightCorner<2, 2>();
  given.diagonal().array() += 1e-9;
  const Eigen::Matrix2d S =
      C.topLeftCorner<2, 2>() -
      C.topRightCorner<2, 2>() * given.ldlt().solve(C.bottomLeftCorner<2, 2>());
  if (S(0, 0) <= 0.0 || S(1, 1) <= 0.0 || S(0, 1) <= 0.0) return 0.0;  // wrong sign: no inertia
  return std::min(1.0, S(0, 1) * S(0, 1) / (S(0, 0) * S(1, 1)));
}

}  // namespace odmc
