#include "odmc/estimator/options.h"

#include <cmath>

#include "odmc/text/refusal.h"

namespace odmc {

bool EstimatorOptions::IsValid(std::string* error) const {
  if (!(window_s > 0.0 && window_s <= 60.0)) return Invalid(error, "window_s must be in (0, 60]");
  if (!(keyframe_rate_hz >= 5.0 && keyframe_rate_hz <= 1000.0)) {
    return Invalid(error, "keyframe_rate_hz must be in [5, 1000]");
  }
  if (window_s * keyframe_rate_hz < 3.0)
    return Invalid(error, "window_s must hold at least 3 keyframes");
  if (dynamics_form != "midpoint" && dynamics_form != "euler") {
    return Invalid(error, "dynamics_form must be midpoint or euler");
  }
  if (solver != "incremental" && solver != "ceres") {
    return Invalid(error, "solver must be incremental or ceres");
  }
  const auto is_positive = [](double x) { return x > 0.0 && std::isfinite(x); };
  const auto is_not_negative = [](double x) { return x >= 0.0 && std::isfinite(x); };
  struct Named {
    const char* name;
    double value;
  };
  for (const Named& option : {Named{"max_gap_s", max_gap_s}, Named{"patience_s", patience_s},
                              Named{"max_update_time_s", max_update_time_s},
                              Named{"process_noise_floor", process_noise_floor},
                              Named{"kinematic_position_m", kinematic_position_m},
                              Named{"kinematic_rotation_rad", kinematic_rotation_rad},
                              Named{"gyro_noise_rad_s", gyro_noise_rad_s},
                              Named{"accelerometer_noise_m_s2", accelerometer_noise_m_s2},
                              Named{"bias_interval_s", bias_interval_s},
                              Named{"gyro_bias_sigma_rad_s", gyro_bias_sigma_rad_s},
                              Named{"accelerometer_bias_sigma_m_s2", accelerometer_bias_sigma_m_s2},
                              Named{"gyro_bias_walk", gyro_bias_walk},
                              Named{"accelerometer_bias_walk", accelerometer_bias_walk}}) {
    if (!is_positive(option.value))
      return Invalid(error, std::string(option.name) + " must be positive");
  }
  for (const Named& option :
       {Named{"huber_width", huber_width}, Named{"position_noise_m", position_noise_m},
        Named{"attitude_noise_rad", attitude_noise_rad},
        Named{"velocity_noise_m_s", velocity_noise_m_s},
        Named{"rate_noise_rad_s", rate_noise_rad_s},
        Named{"rotor_speed_noise_rad_s", rotor_speed_noise_rad_s},
        Named{"function_tolerance", function_tolerance}, Named{"k_f_walk_rate", k_f_walk_rate},
        Named{"take_off_height_m", phases.take_off_height_m},
        Named{"take_off_speed_m_s", phases.take_off_speed_m_s},
        Named{"landed_thrust_ratio", phases.landed_thrust_ratio},
        Named{"near_ground_m", phases.near_ground_m}}) {
    if (!is_not_negative(option.value)) {
      return Invalid(error, std::string(option.name) + " must be a number and not negative");
    }
  }
  if (!(inertia_gate_r_squared >= 0.0 && inertia_gate_r_squared <= 1.0)) {
    return Invalid(error, "inertia_gate_r_squared must be in [0, 1]");
  }
  if (phases.landed_thrust_ratio >= 1.0)
    return Invalid(error, "landed_thrust_ratio must be below 1");
  if (max_iterations < 1) return Invalid(error, "max_iterations must be at least 1");
  if (num_threads < 1) return Invalid(error, "num_threads must be at least 1");
  return true;
}

EstimatorOptions OfflineOptions() {
  EstimatorOptions options;
  options.max_update_time_s = 10.0;  // its work is bounded, too, see LearningSchedule
  return options;
}

}  // namespace odmc
