#pragma once

#include <array>
#include <string>

#include "odmc/phases/phase_detector.h"
#include "odmc/window/window_solver.h"

namespace odmc {

/// Options of the estimator; config/estimator.yaml documents every key.
struct EstimatorOptions {
  double window_s = 1.0;                   ///< length of the sliding window [s], > 0
  double keyframe_rate_hz = 100.0;         ///< at most this many keyframes a second, > 0
  std::string dynamics_form = "midpoint";  ///< midpoint | euler (the paper's, corrected)
  double huber_width = 6.0;  ///< of the whitened dynamics residual [-]; 0: no robust loss
  /// A longer hole in a stream starts a new chain of states [s]; of a slow stream one longer than
  /// StreamPace::Hole_s().
  double max_gap_s = 0.06;
  double patience_s = 0.3;  ///< how long a silent stream is waited for [s]

  /// incremental | ceres (the reference).
  std::string solver = "incremental";
  int max_iterations = 1;            ///< solver iterations per update, >= 1
  double max_update_time_s = 0.008;  ///< bound on one solve [s]
  double function_tolerance = 1e-6;  ///< relative change of cost that ends a solve
  int num_threads = 1;               ///< for Ceres' evaluation of factors

  // Odometry noise per sample; 0: measured on the stream.
  double position_noise_m = 0.0;
  double attitude_noise_rad = 0.0;
  double velocity_noise_m_s = 0.0;
  double rate_noise_rad_s = 0.0;
  double rotor_speed_noise_rad_s = 0.0;  ///< 0: measured on the stream
  double process_noise_floor = 1.0;      ///< scale on the least unmodelled force and torque [-]
  double kinematic_position_m = 5e-4;    ///< floor of e_k: jitter of the odometry [m]
  double kinematic_rotation_rad = 5e-4;  ///< floor of e_theta [rad]

  double gyro_noise_rad_s = 0.01;              ///< one gyro sample
  double accelerometer_noise_m_s2 = 0.3;       ///< mean specific force over a keyframe interval
  double bias_interval_s = 1.0;                ///< one pair of biases per this time
  double gyro_bias_sigma_rad_s = 0.05;         ///< prior
  double accelerometer_bias_sigma_m_s2 = 0.3;  ///< prior
  double gyro_bias_walk = 0.002;               ///< [rad/s/sqrt(s)]
  double accelerometer_bias_walk = 0.02;       ///< [m/s^2/sqrt(s)]

  /// A sudden change of what the model leaves unexplained makes the estimate start to learn anew,
  /// from where it stands (ChangeDetector). For vehicles whose load changes in flight.
  bool detect_changes = false;
  double inertia_gate_r_squared = 0.5;  ///< see InertiaGate; 0 always lets the inertia free
  /// Axes whose inertia stays at its prior, whatever a flight seems to show: it is known from
  /// elsewhere. Set by programs, no field of a file.
  std::array<bool, 3> inertia_is_known = {false, false, false};
  /// k_f, and k_m with it, as a random walk: relative change [1/sqrt(s)]; 0: constants.
  double k_f_walk_rate = 0.0;
  PhaseOptions phases;

  template <typename Visitor>
  void Visit(Visitor* v) {
    v->Field("window_s", &window_s);
    v->Field("keyframe_rate_hz", &keyframe_rate_hz);
    v->Field("dynamics_form", &dynamics_form);
    v->Field("huber_width", &huber_width);
    v->Field("max_gap_s", &max_gap_s);
    v->Field("patience_s", &patience_s);
    v->Field("solver", &solver);
    v->Field("max_iterations", &max_iterations);
    v->Field("max_update_time_s", &max_update_time_s);
    v->Field("function_tolerance", &function_tolerance);
    v->Field("num_threads", &num_threads);
    v->Field("position_noise_m", &position_noise_m);
    v->Field("attitude_noise_rad", &attitude_noise_rad);
    v->Field("velocity_noise_m_s", &velocity_noise_m_s);
    v->Field("rate_noise_rad_s", &rate_noise_rad_s);
    v->Field("rotor_speed_noise_rad_s", &rotor_speed_noise_rad_s);
    v->Field("process_noise_floor", &process_noise_floor);
    v->Field("kinematic_position_m", &kinematic_position_m);
    v->Field("kinematic_rotation_rad", &kinematic_rotation_rad);
    v->Field("gyro_noise_rad_s", &gyro_noise_rad_s);
    v->Field("accelerometer_noise_m_s2", &accelerometer_noise_m_s2);
    v->Field("bias_interval_s", &bias_interval_s);
    v->Field("gyro_bias_sigma_rad_s", &gyro_bias_sigma_rad_s);
    v->Field("accelerometer_bias_sigma_m_s2", &accelerometer_bias_sigma_m_s2);
    v->Field("gyro_bias_walk", &gyro_bias_walk);
    v->Field("accelerometer_bias_walk", &accelerometer_bias_walk);
    v->Field("detect_changes", &detect_changes);
    v->Field("inertia_gate_r_squared", &inertia_gate_r_squared);
    v->Field("k_f_walk_rate", &k_f_walk_rate);
    phases.Visit(v);
  }

  /// True if usable; otherwise false with a sentence for the user in `error`.
  bool IsValid(std::string* error) const;
};

/// Options for a log that is read back: no solve is cut short by the clock, so that a flight gives
/// the same numbers on any machine, loaded or not.
EstimatorOptions OfflineOptions();

}  // namespace odmc
