#pragma once

#include <ceres/cost_function.h>

#include <Eigen/Core>
#include <array>
#include <optional>

#include "odmc/factors/interval_model.h"
#include "odmc/factors/state.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// Standard deviations of one odometry sample.
struct OdometryNoise {
  double position_m = 0.01;
  double attitude_rad = 0.003;
  double velocity_m_s = 0.03;
  double rate_rad_s = 0.01;
};

/// Measured pose, and velocity and body rates where the source has them, of one keyframe.
///
///   block 0: state (13)
///
/// Residual, whitened: p - p̂, Log(q̂⁻¹ q), then v - v̂ and w - ŵ where measured (6, 9 or 12).
class OdometryFactor final : public ceres::CostFunction {
 public:
  /// @param with_rate false leaves out body rates even where measured (an IMU's gyro serves
  /// instead)
  OdometryFactor(const OdometrySample& sample, const OdometryNoise& noise, bool with_rate) {
    Set(sample, noise, with_rate);
  }
  /// Becomes what the constructor makes, as all factors' Set(): spares are used again so.
  void Set(const OdometrySample& sample, const OdometryNoise& noise, bool with_rate);
  bool Evaluate(double const* const* blocks, double* residual, double** jacobians) const override;

 private:
  OdometrySample sample_;
  OdometryNoise noise_;
  bool with_velocity_, with_rate_;
};

/// Kinematics over one interval, without parameters (6×1):
///
///   e_k      p_1 - p_0 - Δt/2 (v_0 + v_1)                                  [m]
///   e_theta  Log(R_0ᵀ R_1) - Δt/2 (w_0 + w_1)                              [rad]
///
/// of the sensor S (model.md 4.2, Eq. (M8), writes e_k at the centre of mass; at S it has no
/// parameters, and the two differ by the trapezoid error of the lever arm's motion only). With
/// Form::kEuler only e_theta with w_0 remains (3×1), since DynamicsFactor then has the position:
/// model.md 4.1, Eq. (M6).
///
///   blocks 0, 1: states (13)
class KinematicFactor final : public ceres::CostFunction {
 public:
  /// @param with_rotation false drops e_theta (GyroPreintegrationFactor has it)
  KinematicFactor(double dt, DynamicsForm form, double sigma_position_m, double sigma_rotation_rad,
                  bool with_rotation) {
    Set(dt, form, sigma_position_m, sigma_rotation_rad, with_rotation);
  }
  void Set(double dt, DynamicsForm form, double sigma_position_m, double sigma_rotation_rad,
           bool with_rotation);
  bool Evaluate(double const* const* blocks, double* residual, double** jacobians) const override;

 private:
  double dt_;
  bool euler_, with_rotation_;
  double sigma_position_, sigma_rotation_;
};

/// Gaussian prior on a Euclidean block (biases): (x - mean) / sigma.
class BlockPriorFactor final : public ceres::CostFunction {
 public:
  BlockPriorFactor(const Eigen::VectorXd& mean, const Eigen::VectorXd& sigma);
  bool Evaluate(double const* const* blocks, double* residual, double** jacobians) const override;

 private:
  Eigen::VectorXd mean_, sigma_;
};

/// Random walk between two bias blocks (gyro, accelerometer; 6): (b_1 - b_0) / sigma.
class BiasWalkFactor final : public ceres::CostFunction {
 public:
  explicit BiasWalkFactor(const Eigen::Matrix<double, 6, 1>& sigma) { Set(sigma); }
  void Set(const Eigen::Matrix<double, 6, 1>& sigma);
  bool Evaluate(double const* const* blocks, double* residual, double** jacobians) const override;

 private:
  Eigen::Matrix<double, 6, 1> sigma_;
};

}  // namespace odmc
