#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "odmc/model/dynamic_model.h"

namespace odmc {

/// Where a simulated vehicle is and how it moves.
struct RigidBodyState {
  Eigen::Vector3d p_WB = Eigen::Vector3d::Zero();            ///< Bo in W [m]
  Eigen::Quaterniond q_WB = Eigen::Quaterniond::Identity();  ///< unit
  Eigen::Vector3d v_WB = Eigen::Vector3d::Zero();            ///< of Bo, in W [m/s]
  Eigen::Vector3d w_WB_B = Eigen::Vector3d::Zero();          ///< [rad/s]
  RotorVector rotor_speed;                                   ///< >= 0 [rad/s]
  /// Pull of a suspended load per unit of load, in W [m/s²]; its user moves it, see Pendulum.
  Eigen::Vector3d load_pull_W = Eigen::Vector3d(0.0, 0.0, -9.81);
};

/// Force and torque about Bcm, both in B.
struct BodyWrench {
  Eigen::Vector3d f_B = Eigen::Vector3d::Zero();        ///< [N]
  Eigen::Vector3d tau_Bcm_B = Eigen::Vector3d::Zero();  ///< [N m]
};

/// Rate of change of a RigidBodyState; the rotors have their closed form.
struct RigidBodyRate {
  Eigen::Vector3d d_p_WB;
  Eigen::Vector4d d_q_WB;  ///< x, y, z, w
  Eigen::Vector3d d_v_WB;
  Eigen::Vector3d d_w_WB_B;
};

/// Rotors that follow a command with a first-order lag: dOmega/dt = (Omega_cmd - Omega) / T.
/// Solved exactly, so that speed, its square and both rates are right at every instant.
struct MotorLag {
  double time_constant_s = 0.025;  ///< > 0

  /// Speeds `dt` after `speed` under a constant `speed_cmd` (n×1, rad/s).
  RotorVector After(const RotorVector& speed, const RotorVector& speed_cmd, double dt) const;

  /// All that effects may ask of rotors at this instant.
  RotorState At(const RotorVector& speed, const RotorVector& speed_cmd) const;
};

/// Exact flight of a DynamicModel at given values: Newton-Euler about Bcm, model.md Eq. (A),
/// written for the body origin as Eq. (B), with full inertia, wind, motor lag and an external
/// wrench. Knows no ground; contact is an external wrench or a phase its user holds. Immutable,
/// thread-compatible; `model` must outlive it.
class RigidBody {
 public:
  RigidBody(const DynamicModel& model, const ModelValues& values, const MotorLag& motor = {});

  const DynamicModel& model() const { return *model_; }
  const BodyProperties& properties() const { return properties_; }
  const MotorLag& motor() const { return motor_; }

  /// Flies on with other values, and with the body of the instant `time_s`.
  void Vary(const ModelValues& values, double time_s);

  /// What effects see of `state` while the rotors are told `speed_cmd`.
  FlightState FlightStateOf(double time_s, const RigidBodyState& state,
                            const RotorVector& speed_cmd) const;

  /// The model's own wrench, without gravity or anything external.
  BodyWrench WrenchOf(const FlightState& state) const;

  /// Rates of `state` under a total wrench (model and external).             model.md Eq. (A), (B)
  RigidBodyRate RateOf(const RigidBodyState& state, const BodyWrench& wrench) const;

  /// State after one Runge-Kutta step (order 4) of `step_s`, the command and the external wrench
  /// (constant in B) held over it.
  RigidBodyState Step(double time_s, const RigidBodyState& state, const RotorVector& speed_cmd,
                      const BodyWrench& external, double step_s) const;

 private:
  const DynamicModel* model_;
  ModelValues values_;
  BodyProperties properties_;
  Eigen::Matrix3d I_inverse_;
  MotorLag motor_;
};

}  // namespace odmc
