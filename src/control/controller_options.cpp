#include "odmc/control/controller_options.h"

#include <cmath>

#include "odmc/text/refusal.h"

namespace odmc {
namespace {

constexpr double kAttitudeSlower = 3.0, kPositionSlower = 7.5;  // than the rate loop
constexpr double kPositionDamping = 0.8;
constexpr double kYawAttitude = 1.0 / 3.0, kYawRate = 0.5;  // of the gains about x and y

Eigen::Vector3d OrDerived(const Eigen::Vector3d& stated, const Eigen::Vector3d& derived) {
  return (stated.array() > 0.0).select(stated, derived);
}

}  // namespace

ControllerGains GainsFor(const ControllerOptions& options) {
  const double rate = options.motor_lead / (2.0 * options.motor_time_constant_s);
  const double attitude = rate / kAttitudeSlower;
  const double position = rate / kPositionSlower;  // natural frequency [rad/s]
  const Eigen::Vector3d ones = Eigen::Vector3d::Ones();
  ControllerGains gains;
  gains.position_1_s2 = OrDerived(options.position_gain_1_s2, position * position * ones);
  gains.velocity_1_s =
      OrDerived(options.velocity_gain_1_s, 2.0 * kPositionDamping * position * ones);
  gains.attitude_1_s =
      OrDerived(options.attitude_gain_1_s, attitude * Eigen::Vector3d(1.0, 1.0, kYawAttitude));
  gains.rate_1_s = OrDerived(options.rate_gain_1_s, rate * Eigen::Vector3d(1.0, 1.0, kYawRate));
  return gains;
}

bool ControllerOptions::IsValid(std::string* error) const {
  for (const Eigen::Vector3d* gain :
       {&position_gain_1_s2, &velocity_gain_1_s, &attitude_gain_1_s, &rate_gain_1_s}) {
    if (!gain->allFinite() || gain->minCoeff() < 0.0)
      return Invalid(error, "a gain must be positive, or 0 to derive it from the motors");
  }
  if (!(motor_time_constant_s > 0.0))
    return Invalid(error, "motor_time_constant_s must be positive");
  if (!(motor_lead >= 1.0 && motor_lead <= 4.0)) return Invalid(error, "motor_lead must be 1 to 4");
  if (!(nominal_battery_voltage_V > 0.0))
    return Invalid(error, "nominal_battery_voltage_V must be positive");
  if (!(filter_hz > 0.0)) return Invalid(error, "filter_hz must be positive");
  if (!(max_tilt_rad > 0.0 && max_tilt_rad < M_PI_2))
    return Invalid(error, "max_tilt_rad must be above 0 and below pi/2");
  if (!(max_rotor_speed_rad_s >= 0.0))
    return Invalid(error, "max_rotor_speed_rad_s must be positive, or 0 to derive it");
  if (!(max_thrust_over_weight > 1.0))
    return Invalid(error, "max_thrust_over_weight must be above 1: with less nothing flies");
  if (!(min_thrust_over_weight >= 0.0 && min_thrust_over_weight < 1.0))
    return Invalid(error, "min_thrust_over_weight must be 0 to below 1");
  if (!(max_feedback_m_s2 > 0.0)) return Invalid(error, "max_feedback_m_s2 must be positive");
  if (!(correction_time_s > 0.0)) return Invalid(error, "correction_time_s must be positive");
  if (!(max_odometry_age_s > 0.0)) return Invalid(error, "max_odometry_age_s must be positive");
  if (!(failsafe_sink_share >= 0.0 && failsafe_sink_share < 0.5))
    return Invalid(error, "failsafe_sink_share must be 0 to below 0.5");
  return true;
}

}  // namespace odmc
