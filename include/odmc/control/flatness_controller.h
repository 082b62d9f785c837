#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <memory>
#include <optional>
#include <string>

#include "odmc/control/allocation.h"
#include "odmc/control/body_state.h"
#include "odmc/control/control_model.h"
#include "odmc/control/controller_options.h"
#include "odmc/control/low_pass.h"
#include "odmc/control/state_predictor.h"
#include "odmc/sensing/samples.h"
#include "odmc/trajectory/flat_reference.h"
#include "odmc/trajectory/flatness.h"

namespace odmc {

/// What the controller is doing.
enum class ControlMode {
  kIdle,      ///< no reference to fly, or it stands on the ground: rotors idle
  kTracking,  ///< follows the reference
  kFailsafe,  ///< odometry is gone: level, sinking
};
const char* NameOf(ControlMode mode);

/// What the controller asks of the vehicle.
struct ControlCommand {
  Stamp stamp = 0;
  ControlMode mode = ControlMode::kIdle;
  RotorVector rotor_speed;  ///< n×1 [rad/s]
  RotorVector throttle;     ///< the same goal for ESCs, n×1, 0 to 1; empty without an actuator
  double collective_thrust_N = 0.0;                      ///< along body z
  Eigen::Vector3d w_WB_B_cmd = Eigen::Vector3d::Zero();  ///< body rates [rad/s]
  Eigen::Quaterniond q_WB_cmd = Eigen::Quaterniond::Identity();
  AllocationReport allocation;
  bool indi = false;  ///< the inner loop was incremental
};

/// Differential-flatness-based controller with an incremental inner loop.
///
///   T_c = m (a_ref + g R_G e3 + K_p e_p + K_v e_v) - f_air                 paper (22), model.md 11
///   w_d = K_R Log(Bᵀ R_d) + Bᵀ R_d w_ref                                   paper (23)
///   α_d = K_w (w_d - w) + Bᵀ R_d dw_ref
///   τ   = τ_f + I (α_d - α_f)           incremental, on filtered rotor torque and acceleration
///   τ   = I α_d + w × I w - τ_air       without; paper (24) with the gain K_M = I K_w
///
/// f_air and τ_air come from the model's own effects; what a centre of mass off the origin does to
/// torques is in the allocation (hubs seen from Bcm), what it does to forces in T_c. Reference
/// rates account for the drag along the reference.
///
/// Where the vehicle has an actuator, the goals Omega_c of the rotor speeds become throttles, too,
/// by the actuator's inverse at the newest battery voltage. The motors are asked for
///   dOmega/dt = motor_lead (Omega_c - Omega) / motor_time_constant_s
/// at the measured speed Omega, which is the lag the gains were made for at any speed; rotor_speed
/// commands reach it near hover only. Without fresh speeds: for the steady Omega_c.
/// Links no solver. Thread-compatible.
class FlatnessController {
 public:
  /// @param model to start with, at its prior values; its vehicle's actuator, if any, is believed
  /// @throws std::invalid_argument for options that are not valid or a vehicle that can't be flown
  FlatnessController(const ControllerOptions& options, std::shared_ptr<const DynamicModel> model);

  /// Brings another estimate into use. The caller limits how fast it changes.
  /// @param values num_parameters()×1 of `model`
  void SetModel(std::shared_ptr<const DynamicModel> model, const ModelValues& values);

  void Add(const OdometrySample& sample);
  void Add(const ImuSample& sample);
  void Add(const RotorSample& sample);
  void Add(const BatterySample& sample);

  /// One control step at `now`; to be called at a steady rate, in the order of time.
  /// @param reference nothing: idle
  ControlCommand Update(Stamp now, const std::optional<FlatReference>& reference);

  /// Where the body is at `now`; nothing before the first odometry.
  std::optional<BodyState> StateAt(Stamp now) const;

  /// Forgets where the vehicle is (a new flight or a clock that stepped back).
  void Reset();

  const ControllerGains& gains() const { return gains_; }
  const ControlModel& model() const { return model_; }
  long jumps() const { return jumps_; }  ///< of the odometry

 private:
  FlatReference Goal(const FlatReference& reference, const BodyState& state) const;
  Eigen::Vector3d Limited(const Eigen::Vector3d& specific_thrust_W) const;
  void Track(const FlatReference& goal, const BodyState& state, ControlCommand* command) const;
  void Sink(const BodyState& state, ControlCommand* command) const;
  Eigen::Vector3d Torque(const Eigen::Vector3d& dw_WB_B, const BodyState& state,
                         bool incremental) const;
  void Filter(Stamp now);
  void HoldInertial(Stamp now);
  bool HasRates(Stamp now) const;
  bool HasRotors(Stamp now) const;
  Eigen::Vector3d Rates(Stamp now) const;
  RotorVector RotorSpeeds() const;
  RotorVector Driven(const RotorVector& goal, Stamp now) const;
  RotorVector Throttle(const RotorVector& goal, Stamp now) const;
  void BuildAllocation();

  ControllerOptions options_;
  ControllerGains gains_;
  ControlModel model_;
  std::shared_ptr<const DynamicModel> dynamics_;  // of model_
  std::optional<Allocation> allocation_;
  double max_squared_, min_squared_;  // of the nominal vehicle: limits of its motors [rad²/s²]
  StatePredictor predictor_;
  LowPass rate_filter_, torque_filter_;
  std::optional<ImuSample> imu_;
  std::optional<RotorSample> rotors_;
  std::optional<double> voltage_V_;                           // of the battery, newest
  Eigen::Vector3d odometry_rates_ = Eigen::Vector3d::Zero();  // of the body, newest [rad/s]
  std::optional<Stamp> last_update_;
  long jumps_ = 0;
};

}  // namespace odmc
