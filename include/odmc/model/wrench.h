#pragma once

#include <Eigen/Core>
#include <vector>

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

/// Largest number of parameters a whole model may have.
constexpr int kMaxModelParameters = 96;

/// Derivative of a wrench about Bcm: rows f_B, tau_Bcm_B (6).
struct ModelWrenchJacobians {
  Eigen::Matrix<double, 6, kNumFlightStateColumns> d_state;
  bool by_pose = false;  ///< whether d_state's columns of attitude and position are not all zero
  Eigen::Matrix<double, 6, 3> d_p_BBcm;  ///< with the body frame held
  Eigen::Matrix<double, 6, Eigen::Dynamic, 0, 6, kMaxModelParameters>
      d_values;  ///< 6×num_parameters(), centre of mass held
  /// Torque by the value it takes of its own (TorqueAnchor), where there is one.
  Eigen::Vector3d d_anchor = Eigen::Vector3d::Zero();
};

/// Where one effect adds the derivatives of its wrench: carries them to Bcm and to the places of
/// the effect's parameters among the model's.
class WrenchJacobians {
 public:
  /// @param columns place in `J->d_values` of each of the effect's values, -1 for none
  /// @param force, torque which rows to add to
  WrenchJacobians(const Eigen::Vector3d& p_BBcm, const std::vector<int>& columns, bool force,
                  bool torque, ModelWrenchJacobians* J)
      : p_BBcm_(p_BBcm), columns_(columns.data()), force_(force), torque_(torque), J_(J) {}

  /// Derivative of Wrench::AddForceAt() with respect to three state columns from `column` on (3×3).
  void AddForceAt(const Eigen::Vector3d& p_BP, int column, const Eigen::Matrix3d& d_force) {
    AddForceAtCom(column, d_force);
    AddCouple(column, HatTimes(p_BP - p_BBcm_, d_force));
  }
  void AddForceAtCom(int column, const Eigen::Matrix3d& d_force) {
    if (force_) J_->d_state.block<3, 3>(0, column) += d_force;
    J_->by_pose |= column >= kColumnAttitude;
  }
  void AddCouple(int column, const Eigen::Matrix3d& d_couple) {
    if (torque_) J_->d_state.block<3, 3>(3, column) += d_couple;
    J_->by_pose |= column >= kColumnAttitude;
  }

  /// Derivative of AddForceAt() with respect to the effect's value `i` (3×1).
  void AddForceAtParameter(const Eigen::Vector3d& p_BP, int i, const Eigen::Vector3d& d_force) {
    AddForceAtComParameter(i, d_force);
    AddCoupleParameter(i, (p_BP - p_BBcm_).cross(d_force));
  }
  void AddForceAtComParameter(int i, const Eigen::Vector3d& d_force) {
    if (force_ && columns_[i] >= 0) J_->d_values.block<3, 1>(0, columns_[i]) += d_force;
  }
  void AddCoupleParameter(int i, const Eigen::Vector3d& d_couple) {
    if (torque_ && columns_[i] >= 0) J_->d_values.block<3, 1>(3, columns_[i]) += d_couple;
  }

 private:
  const Eigen::Vector3d p_BBcm_;
  const int* const columns_;
  const bool force_, torque_;
  ModelWrenchJacobians* const J_;
};

}  // namespace odmc
