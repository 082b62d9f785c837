#pragma once

#include <ceres/cost_function.h>

#include <Eigen/Core>

#include "odmc/factors/interval_model.h"
#include "odmc/factors/parameter_layout.h"
#include "odmc/preintegration/imu_interval.h"

namespace odmc {

/// Size of a bias block: gyro bias [rad/s], accelerometer bias [m/s²], both in I.
constexpr int kBiasSize = 6;

/// Standard deviations of the IMU, per keyframe.
struct ImuNoise {
  double gyro_rad_s = 0.01;          ///< of one gyro sample
  double preintegration_rad = 2e-4;  ///< of the rotation over one interval
  double specific_force_m_s2 = 0.3;  ///< of the mean specific force over one interval
};

/// e_theta by the gyro: Log(ΔR(b)ᵀ R_WI0ᵀ R_WI1), the rotation between two keyframes against the
/// integrated gyro, in the IMU frame (3×1) [rad].                         model.md 4.2, Eq. (M8)
///
///   blocks 0, 1: states (13); 2: bias (6); 3: the layout's eta
class GyroPreintegrationFactor final : public ceres::CostFunction {
 public:
  GyroPreintegrationFactor(const ImuInterval& interval, const ImuNoise& noise,
                           const DynamicModel* model, const ParameterLayout* layout) {
    Set(interval, noise, model, layout);
  }
  void Set(const ImuInterval& interval, const ImuNoise& noise, const DynamicModel* model,
           const ParameterLayout* layout);
  bool Evaluate(double const* const* blocks, double* residual, double** jacobians) const override;

 private:
  ImuInterval interval_;
  ImuNoise noise_;
  const DynamicModel* model_;
  const ParameterLayout* layout_;
};

/// Gyro at one keyframe: R_BIᵀ R_BS w_WS_S + b_g - ŵ (3×1) [rad/s].          model.md 4.2, remarks
///
///   block 0: state (13); 1: bias (6); 2: the layout's eta
class GyroFactor final : public ceres::CostFunction {
 public:
  GyroFactor(const Eigen::Vector3d& gyro_I, const ImuNoise& noise, const DynamicModel* model,
             const ParameterLayout* layout) {
    Set(gyro_I, noise, model, layout);
  }
  void Set(const Eigen::Vector3d& gyro_I, const ImuNoise& noise, const DynamicModel* model,
           const ParameterLayout* layout);
  bool Evaluate(double const* const* blocks, double* residual, double** jacobians) const override;

 private:
  Eigen::Vector3d gyro_I_;
  ImuNoise noise_;
  const DynamicModel* model_;
  const ParameterLayout* layout_;
};

/// Mean specific force over one interval against the model's (3×1) [m/s²]:
///
///   R_BIᵀ (F/m - ẇ × r - w × (w × r)) + b_a - â,   r = p_BBcm - p_BI, ẇ = (w_1 - w_0)/Δt
///
/// at the middle of the interval.                                            model.md Eq. (C)
///
///   blocks 0, 1: states (13); 2: bias (6); 3: the layout's eta
class AccelerometerFactor final : public ceres::CostFunction {
 public:
  AccelerometerFactor(const DynamicsMeasurement& measurement,
                      const Eigen::Vector3d& specific_force_I, const Eigen::Vector3d& sigma,
                      const DynamicModel* model, const ParameterLayout* layout) {
    Set(measurement, specific_force_I, sigma, model, layout);
  }
  void Set(const DynamicsMeasurement& measurement, const Eigen::Vector3d& specific_force_I,
           const Eigen::Vector3d& sigma, const DynamicModel* model, const ParameterLayout* layout);
  bool Evaluate(double const* const* blocks, double* residual, double** jacobians) const override;

  /// Puts the rotors' accelerations at better values; between solves only.
  void SetRotorRates(const RotorVector& acceleration, const RotorVector& speed_squared_rate) {
    measurement_.rotors.acceleration = acceleration;
    measurement_.rotors.speed_squared_rate = speed_squared_rate;
  }

  /// Changes the standard deviation per axis [m/s²]; between solves only.
  void SetSigma(const Eigen::Vector3d& sigma) { sigma_ = sigma; }

  const DynamicsMeasurement& measurement() const { return measurement_; }

 private:
  DynamicsMeasurement measurement_;
  Eigen::Vector3d specific_force_I_, sigma_;
  const DynamicModel* model_;
  const ParameterLayout* layout_;
};

}  // namespace odmc
