#include "odmc/sim/world_options.h"

#include <cmath>
#include <limits>
#include <sstream>
#include <utility>

#include "odmc/text/refusal.h"

namespace odmc {
namespace {

constexpr double kNoLimit = std::numeric_limits<double>::max();

struct Range {
  const char* key;
  double value, low, high;
};

bool IsInside(const Range& range, std::string* error) {
  if (range.value >= range.low && range.value <= range.high) return true;
  std::ostringstream text;
  text << range.key << " must be ";
  if (range.high < kNoLimit) {
    text << range.low << " to " << range.high;
  } else {
    text << "a number of at least " << range.low;
  }
  text << ", not " << range.value;
  return Invalid(error, text.str());
}

bool AreFinite(const WorldOptions& o, std::string* error) {
  const std::pair<const char*, const Eigen::Vector3d*> vectors[] = {
      {"wind_m_s", &o.wind_m_s},
      {"jump_m", &o.jump_m},
      {"gyro_bias_rad_s", &o.gyro_bias_rad_s},
      {"accelerometer_bias_m_s2", &o.accelerometer_bias_m_s2},
      {"payload_p_B_m", &o.payload_p_B_m},
      {"cog_shift_m", &o.cog_shift_m},
  };
  for (const auto& [key, vector] : vectors) {
    if (!vector->allFinite()) return Invalid(error, std::string(key) + " is not finite");
  }
  return true;
}

/// All ranges of an array.
template <size_t kSize>
bool AreInside(const Range (&ranges)[kSize], std::string* error) {
  for (const Range& range : ranges) {
    if (!IsInside(range, error)) return false;
  }
  return true;
}

/// The vehicle: rotors, battery.
bool IsVehicleInside(const WorldOptions& o, std::string* error) {
  const Range ranges[] = {
      {"step_s", o.step_s, 1e-5, 0.001},
      {"motor_time_constant_s", o.motor_time_constant_s, 1e-4, 10.0},
      {"max_thrust_over_weight", o.max_thrust_over_weight,
       o.max_thrust_over_weight == 0.0 ? 0.0 : 1.01, 100.0},
      {"idle_speed_share", o.idle_speed_share, 0.0, 0.99},
      {"motor_S0", o.motor_S0, 0.0, kNoLimit},
      {"motor_S1", o.motor_S1, 0.0, kNoLimit},
      {"motor_S2", o.motor_S2, 0.0, kNoLimit},
      {"battery_empty_V", o.battery_empty_V, 0.0, kNoLimit},
      {"battery_full_V", o.battery_full_V, o.battery_empty_V, kNoLimit},
      {"battery_capacity_As", o.battery_capacity_As, 1.0, kNoLimit},
      {"battery_resistance_ohm", o.battery_resistance_ohm, 0.0, 10.0},
  };
  return AreInside(ranges, error);
}

/// What it flies in, and stands on.
bool AreSurroundingsInside(const WorldOptions& o, std::string* error) {
  const Range ranges[] = {
      {"gust_m_s", o.gust_m_s, 0.0, 50.0},
      {"gust_length_m", o.gust_length_m, 1.0, kNoLimit},
      {"disturbance_force_N", o.disturbance_force_N, 0.0, kNoLimit},
      {"disturbance_torque_Nm", o.disturbance_torque_Nm, 0.0, kNoLimit},
      {"leg_height_m", o.leg_height_m, 0.01, 10.0},
      {"ground_static_sink_m", o.ground_static_sink_m, 0.001, 0.5 * o.leg_height_m},
      {"ground_damping_ratio", o.ground_damping_ratio, 0.0, 1.0},
      {"ground_friction", o.ground_friction, 0.0, 2.0},
      {"start_height_m", o.start_height_m, 0.0, kNoLimit},
  };
  return AreInside(ranges, error);
}

/// Rates are bounded by the step.
bool AreSensorsInside(const WorldOptions& o, std::string* error) {
  const double max_rate = 1.0 / o.step_s;
  const Range ranges[] = {
      {"odometry_rate_hz", o.odometry_rate_hz, 0.0, max_rate},
      {"position_noise_m", o.position_noise_m, 0.0, kNoLimit},
      {"attitude_noise_rad", o.attitude_noise_rad, 0.0, 1.0},
      {"velocity_noise_m_s", o.velocity_noise_m_s, 0.0, kNoLimit},
      {"rate_noise_rad_s", o.rate_noise_rad_s, 0.0, kNoLimit},
      {"odometry_delay_s", o.odometry_delay_s, 0.0, 1.0},
      {"position_drift_m_sqrt_s", o.position_drift_m_sqrt_s, 0.0, kNoLimit},
      {"yaw_drift_rad_sqrt_s", o.yaw_drift_rad_sqrt_s, 0.0, kNoLimit},
      {"imu_rate_hz", o.imu_rate_hz, 0.0, max_rate},
      {"gyro_noise_density", o.gyro_noise_density, 0.0, kNoLimit},
      {"accelerometer_noise_density", o.accelerometer_noise_density, 0.0, kNoLimit},
      {"rotor_rate_hz", o.rotor_rate_hz, 0.0, max_rate},
      {"rotor_noise_rad_s", o.rotor_noise_rad_s, 0.0, kNoLimit},
      {"rotor_quantum_rad_s", o.rotor_quantum_rad_s, 0.0, kNoLimit},
      {"rotor_delay_s", o.rotor_delay_s, 0.0, 1.0},
      {"battery_rate_hz", o.battery_rate_hz, 0.0, max_rate},
  };
  return AreInside(ranges, error);
}

/// What happens on the way.
bool AreEventsInside(const WorldOptions& o, std::string* error) {
  const Range ranges[] = {
      {"jump_at_s", o.jump_at_s, 0.0, kNoLimit},
      {"payload_attach_at_s", o.payload_attach_at_s, 0.0, kNoLimit},
      {"payload_drop_at_s", o.payload_drop_at_s, 0.0, kNoLimit},
      {"payload_kg", o.payload_kg, 0.0, kNoLimit},
      {"cog_shift_at_s", o.cog_shift_at_s, 0.0, kNoLimit},
      {"damage_at_s", o.damage_at_s, 0.0, kNoLimit},
      {"damage_rotor", static_cast<double>(o.damage_rotor), 1.0, kNoLimit},
      {"damage_share", o.damage_share, 0.0, 1.0},
  };
  return AreInside(ranges, error);
}

}  // namespace

bool WorldOptions::IsValid(std::string* error) const {
  if (!IsVehicleInside(*this, error) || !AreSurroundingsInside(*this, error) ||
      !AreSensorsInside(*this, error) || !AreEventsInside(*this, error)) {
    return false;
  }
  if (!AreFinite(*this, error)) return false;
  if (!std::isfinite(battery_slope_V_s)) return Invalid(error, "battery_slope_V_s is not finite");
  if (motor_S2 > 0.0 && motor_S1 <= 0.0) {
    return Invalid(error, "motor_S1 must be positive where motor_S2 is");
  }
  if (payload_attach_at_s > 0.0 && payload_kg <= 0.0) {
    return Invalid(error, "payload_kg must be positive where payload_attach_at_s is");
  }
  return true;
}

}  // namespace odmc
