#pragma once

#include <Eigen/Core>
#include <string>

#include "odmc/control/control_model.h"

namespace odmc {

/// Gains of the cascade. In accelerations and rates, so that vehicles of any size share them.
struct ControllerGains {
  Eigen::Vector3d position_1_s2;  ///< K_p, along W
  Eigen::Vector3d velocity_1_s;   ///< K_v, along W
  Eigen::Vector3d attitude_1_s;   ///< K_R, about B
  Eigen::Vector3d rate_1_s;       ///< about B: angular acceleration per error of rate
};

/// Options of the controller; config/controller/default.yaml documents every key.
struct ControllerOptions {
  double motor_time_constant_s = 0.025;  ///< of the rotors' speed, as measured [s], > 0
  /// Rotor speeds are commanded this many times as far beyond the measured ones as they shall go,
  /// which makes motors faster; 1: not at all.
  double motor_lead = 1.5;
  /// Of the battery until the first reading, for vehicles with an actuator [V], > 0.
  double nominal_battery_voltage_V = 15.2;
  // Gains; zero: derived from the motors, see GainsFor().
  Eigen::Vector3d position_gain_1_s2 = Eigen::Vector3d::Zero();
  Eigen::Vector3d velocity_gain_1_s = Eigen::Vector3d::Zero();
  Eigen::Vector3d attitude_gain_1_s = Eigen::Vector3d::Zero();
  Eigen::Vector3d rate_gain_1_s = Eigen::Vector3d::Zero();

  bool indi = true;         ///< incremental inversion on measured rates and rotor speeds
  double filter_hz = 30.0;  ///< low-pass of both for it [Hz], > 0
  double max_tilt_rad = 1.3;
  double max_rotor_speed_rad_s = 0.0;   ///< of the motors; 0: from max_thrust_over_weight
  double max_thrust_over_weight = 3.0;  ///< of the vehicle before any estimate, > 1
  double min_thrust_over_weight = 0.05;
  double max_feedback_m_s2 = 12.0;    ///< limit of what errors of position and velocity ask for
  double correction_time_s = 0.05;    ///< with which odometry corrects the prediction [s], > 0
  double max_odometry_age_s = 0.3;    ///< beyond it the vehicle levels and sinks [s], > 0
  double failsafe_sink_share = 0.05;  ///< of weight by which thrust is then below hover
  CompensatedEffects compensation;

  /// Shows every field, by key, to a reader or a printer.
  template <typename Visitor>
  void Visit(Visitor* v) {
    v->Field("motor_time_constant_s", &motor_time_constant_s);
    v->Field("motor_lead", &motor_lead);
    v->Field("nominal_battery_voltage_V", &nominal_battery_voltage_V);
    v->Field("position_gain_1_s2", &position_gain_1_s2);
    v->Field("velocity_gain_1_s", &velocity_gain_1_s);
    v->Field("attitude_gain_1_s", &attitude_gain_1_s);
    v->Field("rate_gain_1_s", &rate_gain_1_s);
    v->Field("indi", &indi);
    v->Field("filter_hz", &filter_hz);
    v->Field("max_tilt_rad", &max_tilt_rad);
    v->Field("max_rotor_speed_rad_s", &max_rotor_speed_rad_s);
    v->Field("max_thrust_over_weight", &max_thrust_over_weight);
    v->Field("min_thrust_over_weight", &min_thrust_over_weight);
    v->Field("max_feedback_m_s2", &max_feedback_m_s2);
    v->Field("correction_time_s", &correction_time_s);
    v->Field("max_odometry_age_s", &max_odometry_age_s);
    v->Field("failsafe_sink_share", &failsafe_sink_share);
    compensation.Visit(v);
  }

  /// True if usable; otherwise false with a sentence for the user in `error`.
  bool IsValid(std::string* error) const;
};

/// The gains of `options`, each axis that is zero there derived from the motors. With incremental
/// inversion the angular acceleration follows its command as the rotors follow theirs, with the
/// time constant T = motor_time_constant_s / motor_lead. Rates closed around that are critically
/// well damped (ζ = 0.7) for K = 1 / (2 T); each loop further out is slower by a constant factor:
/// attitude K / 3, position K / 7.5 (natural frequency, ζ = 0.8). Yaw, for which rotors have least
/// authority, has a third of the attitude and half of the rate gain.
ControllerGains GainsFor(const ControllerOptions& options);

}  // namespace odmc
