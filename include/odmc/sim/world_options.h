#pragma once

#include <Eigen/Core>
#include <string>

namespace odmc {

/// The world of a flight simulation: motors, battery, air, ground, sensors, and what happens
/// when. Times of events are since the start, 0: never. A rate of 0 switches a sensor off.
struct WorldOptions {
  double step_s = 0.001;  ///< of the integration [s], > 0, <= 0.001; stamps are whole nanoseconds

  double motor_time_constant_s = 0.025;  ///< of the first-order lag [s], > 0
  double max_thrust_over_weight = 3.5;   ///< all rotors at full battery, > 1; 0: no limit
  double idle_speed_share = 0.1;  ///< least speed while armed, of the speed at hover, 0 to < 1
  double motor_S0 = 0.0;  ///< of model.md section 11 [rad/s²/V]; > 0: the battery's voltage limits
  double motor_S1 = 0.0;  ///< [1/s], > 0 with motor_S2
  double motor_S2 = 0.0;  ///< [1/rad]; 0: first-order lag

  double battery_full_V = 16.8;
  double battery_empty_V = 13.2;
  double battery_capacity_As = 5400.0;   ///< from full to empty
  double battery_resistance_ohm = 0.02;  ///< >= 0
  double battery_slope_V_s = 0.0;        ///< of the open circuit by itself, whatever is drawn

  Eigen::Vector3d wind_m_s = Eigen::Vector3d::Zero();  ///< mean, in W
  double gust_m_s = 0.0;                               ///< standard deviation per axis; 0: none
  double gust_length_m = 20.0;                         ///< of the turbulence, >= 1

  /// White force and torque about Bcm, along body axes, held over 10 ms (so this is the standard
  /// deviation of the 10 ms mean). For the vehicle of model.md section 8; for others the force
  /// scales with weight and the torque with weight times arm length.
  double disturbance_force_N = 0.05;
  double disturbance_torque_Nm = 0.001;

  bool ground = true;                   ///< false: nothing below the vehicle
  double leg_height_m = 0.05;           ///< feet below Bo, >= 0.01
  double ground_static_sink_m = 0.003;  ///< of the vehicle at rest, 0.001 to half the leg height
  double ground_damping_ratio = 0.6;    ///< 0 to 1
  double ground_friction = 0.8;         ///< Coulomb's coefficient, 0 to 2
  double start_height_m = 0.0;          ///< 0: stands, rotors stopped; above: in hover

  double odometry_rate_hz = 100.0;
  double position_noise_m = 0.005;
  double attitude_noise_rad = 0.002;
  double velocity_noise_m_s = 0.03;
  double rate_noise_rad_s = 0.01;
  double odometry_delay_s = 0.02;                    ///< arrives so long after its stamp, 0 to 1
  double position_drift_m_sqrt_s = 0.0;              ///< random walk per axis [m/√s]
  double yaw_drift_rad_sqrt_s = 0.0;                 ///< random walk about the origin [rad/√s]
  double jump_at_s = 0.0;                            ///< positions are off by jump_m from then on
  Eigen::Vector3d jump_m = Eigen::Vector3d::Zero();  ///< in W

  double imu_rate_hz = 500.0;
  double gyro_noise_density = 2.0e-4;                                 ///< [rad/s/√Hz]
  double accelerometer_noise_density = 2.0e-3;                        ///< [m/s²/√Hz]
  Eigen::Vector3d gyro_bias_rad_s = Eigen::Vector3d::Zero();          ///< in I
  Eigen::Vector3d accelerometer_bias_m_s2 = Eigen::Vector3d::Zero();  ///< in I

  double rotor_rate_hz = 500.0;
  double rotor_noise_rad_s = 2.0;
  double rotor_quantum_rad_s = 0.0;  ///< readings are multiples of it; 0: any
  double rotor_delay_s = 0.0;  ///< samples show the speeds of so long before their stamp, 0 to 1
  double battery_rate_hz = 10.0;

  double payload_attach_at_s = 0.0;
  double payload_drop_at_s = 0.0;
  double payload_kg = 0.0;                                  ///< > 0 where it is attached
  Eigen::Vector3d payload_p_B_m = Eigen::Vector3d::Zero();  ///< from Bo
  double cog_shift_at_s = 0.0;
  Eigen::Vector3d cog_shift_m = Eigen::Vector3d::Zero();  ///< in B
  double damage_at_s = 0.0;
  int damage_rotor = 1;       ///< as the vehicle file counts, from 1
  double damage_share = 0.0;  ///< of its thrust and torque that is lost, 0 to 1

  /// Shows every field, by key, to a reader or a printer.
  template <typename Visitor>
  void Visit(Visitor* v);

  /// True if usable; otherwise false with a sentence for the user in `error`.
  bool IsValid(std::string* error) const;
};

template <typename Visitor>
void WorldOptions::Visit(Visitor* v) {
  v->Field("step_s", &step_s);
  v->Field("motor_time_constant_s", &motor_time_constant_s);
  v->Field("max_thrust_over_weight", &max_thrust_over_weight);
  v->Field("idle_speed_share", &idle_speed_share);
  v->Field("motor_S0", &motor_S0);
  v->Field("motor_S1", &motor_S1);
  v->Field("motor_S2", &motor_S2);
  v->Field("battery_full_V", &battery_full_V);
  v->Field("battery_empty_V", &battery_empty_V);
  v->Field("battery_capacity_As", &battery_capacity_As);
  v->Field("battery_resistance_ohm", &battery_resistance_ohm);
  v->Field("battery_slope_V_s", &battery_slope_V_s);
  v->Field("wind_m_s", &wind_m_s);
  v->Field("gust_m_s", &gust_m_s);
  v->Field("gust_length_m", &gust_length_m);
  v->Field("disturbance_force_N", &disturbance_force_N);
  v->Field("disturbance_torque_Nm", &disturbance_torque_Nm);
  v->Field("ground", &ground);
  v->Field("leg_height_m", &leg_height_m);
  v->Field("ground_static_sink_m", &ground_static_sink_m);
  v->Field("ground_damping_ratio", &ground_damping_ratio);
  v->Field("ground_friction", &ground_friction);
  v->Field("start_height_m", &start_height_m);
  v->Field("odometry_rate_hz", &odometry_rate_hz);
  v->Field("position_noise_m", &position_noise_m);
  v->Field("attitude_noise_rad", &attitude_noise_rad);
  v->Field("velocity_noise_m_s", &velocity_noise_m_s);
  v->Field("rate_noise_rad_s", &rate_noise_rad_s);
  v->Field("odometry_delay_s", &odometry_delay_s);
  v->Field("position_drift_m_sqrt_s", &position_drift_m_sqrt_s);
  v->Field("yaw_drift_rad_sqrt_s", &yaw_drift_rad_sqrt_s);
  v->Field("jump_at_s", &jump_at_s);
  v->Field("jump_m", &jump_m);
  v->Field("imu_rate_hz", &imu_rate_hz);
  v->Field("gyro_noise_density", &gyro_noise_density);
  v->Field("accelerometer_noise_density", &accelerometer_noise_density);
  v->Field("gyro_bias_rad_s", &gyro_bias_rad_s);
  v->Field("accelerometer_bias_m_s2", &accelerometer_bias_m_s2);
  v->Field("rotor_rate_hz", &rotor_rate_hz);
  v->Field("rotor_noise_rad_s", &rotor_noise_rad_s);
  v->Field("rotor_quantum_rad_s", &rotor_quantum_rad_s);
  v->Field("rotor_delay_s", &rotor_delay_s);
  v->Field("battery_rate_hz", &battery_rate_hz);
  v->Field("payload_attach_at_s", &payload_attach_at_s);
  v->Field("payload_drop_at_s", &payload_drop_at_s);
  v->Field("payload_kg", &payload_kg);
  v->Field("payload_p_B_m", &payload_p_B_m);
  v->Field("cog_shift_at_s", &cog_shift_at_s);
  v->Field("cog_shift_m", &cog_shift_m);
  v->Field("damage_at_s", &damage_at_s);
  v->Field("damage_rotor", &damage_rotor);
  v->Field("damage_share", &damage_share);
}

}  // namespace odmc
