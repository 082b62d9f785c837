#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <vector>

#include "odmc/model/body_wrench.h"
#include "odmc/model/dynamic_model.h"
#include "odmc/model/motor.h"

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

/// Sum of two wrenches about the same point.
inline BodyWrench operator+(const BodyWrench& a, const BodyWrench& b) {
  return {a.f_B + b.f_B, a.tau_Bcm_B + b.tau_Bcm_B};
}

/// Rate of change of a RigidBodyState; the rotors have their closed form.
struct RigidBodyRate {
  Eigen::Vector3d d_p_WB;
  Eigen::Vector4d d_q_WB;  ///< x, y, z, w
  Eigen::Vector3d d_v_WB;
  Eigen::Vector3d d_w_WB_B;
};

/// Rotors that follow a command, solved exactly, so that speed, its square and both rates are right
/// at every instant. Either a first-order lag, dOmega/dt = (Omega_cmd - Omega) / T, or, where
/// S2 > 0, a motor at the voltage whose steady speed is the command:
///   dOmega/dt = S1 (Omega_cmd - Omega) + S2 (Omega_cmd² - Omega²)          model.md section 11
struct MotorLag {
  double time_constant_s = 0.025;  ///< of the lag, > 0
  double S1 = 0.0;                 ///< [1/s], > 0 where S2 > 0
  double S2 = 0.0;                 ///< [1/rad]; 0: the lag
  /// One per rotor, in place of all these: the motors of a calibrated actuator; empty: not known.
  std::vector<MotorDynamics> motors{};

  /// Motors of a vehicle that has an actuator.
  static MotorLag Of(const Actuator& actuator, int num_rotors);

  /// Speeds `dt` after `speed` under a constant `speed_cmd` (n×1, rad/s).
  RotorVector After(const RotorVector& speed, const RotorVector& speed_cmd, double dt) const;

  /// All that effects may ask of rotors at this instant.
  RotorState At(const RotorVector& speed, const RotorVector& speed_cmd) const;

 private:
  MotorDynamics DynamicsOf(int rotor) const {
    return motors.empty() ? MotorDynamics{S1, S2} : motors[static_cast<size_t>(rotor)];
  }
};

/// What makes a vehicle another one than its model says: a point mass carried rigidly, and a centre
/// of mass that moved without changing the inertia about it.
struct BodyChange {
  double payload_kg = 0.0;                                ///< 0: none
  Eigen::Vector3d payload_p_B = Eigen::Vector3d::Zero();  ///< from Bo, in B [m]
  Eigen::Vector3d cog_shift_B = Eigen::Vector3d::Zero();  ///< [m]
};

/// Exact flight of a DynamicModel at given values: Newton-Euler about Bcm, model.md Eq. (A),
/// written for the body origin as Eq. (B), with full inertia, wind, motor lag and an external
/// wrench. Knows no ground; contact is an external wrench or a phase its user holds. A change of
/// the body and an extra wind come on top of the model's. Air forces that act at the centre of mass
/// move with it when it shifts; a payload leaves them where they were on the airframe.
/// Thread-compatible; `model` must outlive it.
class RigidBody {
 public:
  RigidBody(const DynamicModel& model, const ModelValues& values, const MotorLag& motor = {});

  const DynamicModel& model() const { return *model_; }
  const ModelValues& values() const { return values_; }
  /// Change and extra wind included.
  const BodyProperties& properties() const { return properties_; }
  const BodyChange& change() const { return change_; }
  const MotorLag& motor() const { return motor_; }

  /// Flies on with other values, and with the body of the instant `time_s`.
  void Vary(const ModelValues& values, double time_s);

  /// Flies on as a changed body: Bo keeps its velocity.
  void Change(const BodyChange& change);

  /// Flies on in air that moves, in W [m/s], relative to the model's own wind.
  void SetExtraWind(const Eigen::Vector3d& wind_W);

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
  // Puts the body of `time_s_` together.
  void Shape();

  const DynamicModel* model_;
  ModelValues values_;
  double time_s_ = 0.0;
  BodyChange change_;
  Eigen::Vector3d model_wind_W_;
  Eigen::Vector3d extra_wind_W_ = Eigen::Vector3d::Zero();
  BodyProperties properties_;
  Eigen::Vector3d p_BA_;  // where forces at the airframe's own centre of mass act
  Eigen::Matrix3d I_inverse_;
  MotorLag motor_;
};

}  // namespace odmc
