#pragma once

#include <ceres/cost_function.h>

#include <Eigen/Core>
#include <vector>

#include "odmc/factors/interval_model.h"
#include "odmc/factors/parameter_layout.h"

namespace odmc {

/// Rows of DynamicsResidual().
enum DynamicsRow : int {
  kRowPosition = 0,
  kRowVelocity = 3,
  kRowAngular = 6,
  kNumDynamicsRows = 9
};

/// Derivatives of DynamicsResidual().
struct DynamicsJacobians {
  Eigen::Matrix<double, kNumDynamicsRows, kStateTangentSize> d_state0, d_state1;
  ValueJacobian<kNumDynamicsRows> d_values;  ///< with respect to physical values
  ValueJacobian<3> d_inertia;                ///< of the inertia's diagonal, for the whitening
};

/// Residual of the equations of motion over one interval (9×1):
///
///   e_p      position, Form E only (zero for Form M, where KinematicFactor has it)     [N s²]
///   e_v      m_0/m (m B_mᵀ (V_1 - V_0 - Δt g) - Δt F), normalised                      [N s]
///   e_alpha  I⁻¹ (I (w_1 - w_0) + Δt w_m × I w_m - Δt τ), normalised                   [rad/s]
///
/// Normalised: the unknown mass and inertia divide the force and the torque, which are clean, and
/// do not multiply differences of noisy velocities; a fit would shrink them. m_0 is the vehicle
/// file's mass.
///
/// in B at the evaluation point. V is the velocity of the centre of mass, F and τ the model's force
/// and torque about it; derivatives: model.md section 6.
///      model.md 4.1, 4.2 and 4.4, Eq. (M6), (M8), (M10), (M47); paper Eq. (19), corrected
/// @param inertia if given, the diagonal of the inertia used [kg m²]
Eigen::Matrix<double, kNumDynamicsRows, 1> DynamicsResidual(
    const DynamicsMeasurement& measurement, const State& state0, const State& state1,
    const DynamicModel& model, const ModelValues& values, Eigen::Vector3d* inertia = nullptr,
    DynamicsJacobians* J = nullptr);

/// Covariance of (e_p, e_v) of Form E per axis and unit force variance (2×2): white force noise
/// integrated over the interval (the paper's 1/4 for 1/3 is singular).
///                                                             model.md section 5, Eq. (M13)
Eigen::Matrix2d EulerTranslationCovariance(double dt);

/// Errors of one interval, as means over it (one standard deviation).    model.md section 5
struct DynamicsNoise {
  Eigen::Vector3d force_N = Eigen::Vector3d::Constant(0.1);      ///< not in the model, body axes
  Eigen::Vector3d torque_Nm = Eigen::Vector3d::Constant(0.002);  ///< not in the model, body axes
  double rotor_force_N = 0.0;                                    ///< from rotor-speed noise
  Eigen::Vector3d rotor_torque_Nm = Eigen::Vector3d::Zero();     ///< from rotor-speed noise
  double rotor_rate_rad_s2 = 0.0;  ///< of each rotor's acceleration, from rotor-speed noise
  Eigen::Vector3d nominal_inertia = Eigen::Vector3d::Constant(0.01);  ///< turns torque_Nm to rad/s²
};

/// What noise of the rotors' accelerations does to the wrench, through effects that take them.
struct RotorRateNoise {
  Eigen::Vector3d force_variance = Eigen::Vector3d::Zero();   ///< body axes [N²]
  Eigen::Vector3d torque_variance = Eigen::Vector3d::Zero();  ///< about Bo [N² m²]
  ValueJacobian<3> d_force, d_torque;                         ///< by physical values, on request
};

/// @param sigma_rad_s2 of each rotor's acceleration, on its own
RotorRateNoise NoiseOfRotorRates(const DynamicsMeasurement& measurement, double sigma_rad_s2,
                                 const DynamicModel& model, const ModelValues& values,
                                 bool jacobians);

/// Ceres view of DynamicsResidual().
///
///   block    size  meaning
///   0, 1     13    states at the ends, on StateManifold
///   2        n     the layout's eta, left out if nothing is estimated
///   3        1     with an anchor (DynamicsMeasurement::anchor_index, of an estimated parameter):
///                  its value for the torque, in eta; constant in a solve
///
/// Residual: e_v, e_alpha (6), or e_v alone (3) without single rotor speeds; Form E has e_p before
/// them. Whitened: e_v by the force errors; e_alpha by a standard deviation that is fixed in rad/s
/// for the unmodelled torque (model.md section 9), and that takes the rotor-speed noise through the
/// live inertia,  σ_α² = Δt² (σ_τ²/I_0² + σ_rotor²/I²). The second part makes the fit that of a
/// line with errors in both coordinates (Deming): without it noise in the torque regressor pulls
/// the inertia up. Likewise the noise of rotor accelerations, through the live coefficients of
/// effects that take them (NoiseOfRotorRates()), in both rows: without it these come out too small.
class DynamicsFactor final : public ceres::CostFunction {
 public:
  /// `model` and `layout` must outlive the factor. @throws std::invalid_argument if dt <= 0.
  DynamicsFactor(const DynamicsMeasurement& measurement, const DynamicsNoise& noise,
                 bool with_torque, const DynamicModel* model, const ParameterLayout* layout) {
    Set(measurement, noise, with_torque, model, layout);
  }
  void Set(const DynamicsMeasurement& measurement, const DynamicsNoise& noise, bool with_torque,
           const DynamicModel* model, const ParameterLayout* layout);

  bool Evaluate(double const* const* blocks, double* residual, double** jacobians) const override;

  /// Puts the rotors' accelerations at better values, with their noise; between solves only.
  void SetRotorRates(const RotorVector& acceleration, const RotorVector& speed_squared_rate,
                     double sigma_rad_s2) {
    measurement_.rotors.acceleration = acceleration;
    measurement_.rotors.speed_squared_rate = speed_squared_rate;
    noise_.rotor_rate_rad_s2 = sigma_rad_s2;
  }

  /// Changes the errors that are not in the model; between solves only.
  void SetModelNoise(const Eigen::Vector3d& force_N, const Eigen::Vector3d& torque_Nm) {
    noise_.force_N = force_N;
    noise_.torque_Nm = torque_Nm;
  }

  /// Frees the inertia about axis `i` from here on: the flight shows it.
  void FreeInertia(int i) { measurement_.inertia_fixed[i] = false; }

  /// DynamicsResidual() at the blocks, in its own units. @returns false if it is not finite
  bool UnwhitenedResidual(double const* const* blocks,
                          Eigen::Matrix<double, kNumDynamicsRows, 1>* e) const;

  const DynamicsMeasurement& measurement() const { return measurement_; }
  const DynamicsNoise& noise() const { return noise_; }
  bool with_torque() const { return with_torque_; }

  /// First row of e_v in the residual.
  int velocity_row() const { return measurement_.form == DynamicsForm::kEuler ? 3 : 0; }

 private:
  template <int N>
  bool EvaluateForm(double const* const* blocks, double* residual, double** jacobians) const;

  /// The measurement, its anchor at the value of the block.
  DynamicsMeasurement AnchoredAt(double const* const* blocks) const;

  DynamicsMeasurement measurement_;
  int anchor_entry_ = -1;  // of eta, -1: none
  DynamicsNoise noise_;
  bool with_torque_;
  const DynamicModel* model_;
  const ParameterLayout* layout_;
};

/// Sizes of a factor's blocks: `states` states, a bias if `bias`, eta if anything is estimated.
void SetBlockSizes(int states, bool bias, const ParameterLayout& layout,
                   std::vector<int32_t>* sizes);

}  // namespace odmc
