#pragma once

#include <Eigen/Core>

#include "odmc/math/so3.h"

namespace odmc {

/// Largest number of parameters of one effect, borrowed ones included.
constexpr int kMaxEffectParameters = 24;

/// Sum of the forces and couples that effects put on the body, in B. Keeps the forces that act at
/// points apart, so that the torque can be taken about any centre of mass.
struct Wrench {
  Eigen::Vector3d f_B = Eigen::Vector3d::Zero();         ///< all forces [N]
  Eigen::Vector3d f_points_B = Eigen::Vector3d::Zero();  ///< those that act at points [N]
  Eigen::Vector3d tau_Bo_B = Eigen::Vector3d::Zero();    ///< of points and couples, about Bo [N m]

  void AddForceAt(const Eigen::Vector3d& p_BP, const Eigen::Vector3d& force_B) {
    f_B += force_B;
    f_points_B += force_B;
    tau_Bo_B += p_BP.cross(force_B);
  }
  void AddForceAtCom(const Eigen::Vector3d& force_B) { f_B += force_B; }
  void AddCouple(const Eigen::Vector3d& couple_B) { tau_Bo_B += couple_B; }

  /// Torque about the centre of mass at p_BBcm (3×1, from Bo, in B) [N m].
  Eigen::Vector3d TorqueAbout(const Eigen::Vector3d& p_BBcm) const {
    return tau_Bo_B - p_BBcm.cross(f_points_B);
  }
};

/// Columns of WrenchJacobians::d_state: the flight state an effect looks at.
enum FlightStateColumn : int {
  kColumnAirVelocity = 0,  ///< v_AB_B
  kColumnAngularRate = 3,  ///< w_WB_B
  kColumnAttitude = 6,     ///< theta of R_WB Exp(theta), with v_AB_B held
  kColumnPosition = 9,     ///< p_WB
  kNumFlightStateColumns = 12,
};

/// Derivatives of a Wrench: rows f_B, f_points_B, tau_Bo_B (9).
struct WrenchJacobians {
  using StateBlock = Eigen::Matrix<double, 3, kNumFlightStateColumns>;
  using ParameterBlock = Eigen::Matrix<double, 9, Eigen::Dynamic, 0, 9, kMaxEffectParameters>;

  Eigen::Matrix<double, 9, kNumFlightStateColumns> d_state =
      Eigen::Matrix<double, 9, kNumFlightStateColumns>::Zero();
  ParameterBlock d_parameters;  ///< 9×n, own parameters then borrowed ones

  /// Derivative of AddForceAt() with respect to three state columns from `column` on (3×3).
  void AddForceAt(const Eigen::Vector3d& p_BP, int column, const Eigen::Matrix3d& d_force) {
    d_state.block<3, 3>(0, column) += d_force;
    d_state.block<3, 3>(3, column) += d_force;
    d_state.block<3, 3>(6, column) += Hat(p_BP) * d_force;
  }
  void AddForceAtCom(int column, const Eigen::Matrix3d& d_force) {
    d_state.block<3, 3>(0, column) += d_force;
  }
  void AddCouple(int column, const Eigen::Matrix3d& d_couple) {
    d_state.block<3, 3>(6, column) += d_couple;
  }

  /// Derivative of AddForceAt() with respect to parameter `i` (3×1).
  void AddForceAtParameter(const Eigen::Vector3d& p_BP, int i, const Eigen::Vector3d& d_force) {
    d_parameters.block<3, 1>(0, i) += d_force;
    d_parameters.block<3, 1>(3, i) += d_force;
    d_parameters.block<3, 1>(6, i) += p_BP.cross(d_force);
  }
  void AddForceAtComParameter(int i, const Eigen::Vector3d& d_force) {
    d_parameters.block<3, 1>(0, i) += d_force;
  }
  void AddCoupleParameter(int i, const Eigen::Vector3d& d_couple) {
    d_parameters.block<3, 1>(6, i) += d_couple;
  }
};

}  // namespace odmc
