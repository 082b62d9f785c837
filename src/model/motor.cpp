#include "odmc/model/motor.h"

#include <algorithm>
#include <cmath>

namespace odmc {

double MotorDynamics::SteadySpeed(double drive) const {
  if (!(drive > 0.0)) return 0.0;
  // The positive root of S2 w² + S1 w = drive, in a form that S2 = 0 does not break.
  return 2.0 * drive / (S1 + std::sqrt(S1 * S1 + 4.0 * S2 * drive));
}

double MotorDynamics::After(double speed, double drive, double dt) const {
  return MotorSpeedAfter(speed, SteadySpeed(drive), S1, S2, dt);
}

double MotorSpeedAfter(double speed, double steady, double S1, double S2, double dt) {
  const double decay = std::exp(-(S1 + 2.0 * S2 * steady) * dt);
  // Both sides of the ratio times S2, so that S2 = 0 is the first-order lag.
  const double far = S2 * steady + S1;
  const double ratio = (steady - speed) / (S2 * speed + far) * decay;
  return (steady - ratio * far) / (1.0 + S2 * ratio);
}

double EscMap::Drive(double throttle, double voltage_V) const {
  return root * voltage_V * std::sqrt(std::max(throttle - start, 0.0)) + linear * throttle +
         constant;
}

double EscMap::ThrottleFor(double drive, double voltage_V) const {
  // With s² = throttle - start: linear s² + root V s = rest.
  const double rest = drive - constant - linear * start, slope = root * voltage_V;
  const double discriminant = slope * slope + 4.0 * linear * rest;
  const double divisor = slope + std::sqrt(std::max(discriminant, 0.0));
  if (!(divisor > 0.0)) return start;
  const double s = 2.0 * rest / divisor;
  return s > 0.0 ? start + s * s : start;
}

double Motor::ThrottleFor(double speed, double acceleration, double voltage_V) const {
  return std::clamp(esc.ThrottleFor(dynamics.DriveFor(speed, acceleration), voltage_V), 0.0, 1.0);
}

double Actuator::CommandFor(int rotor, double speed, double acceleration, double voltage_V) const {
  const double throttle = MotorOf(rotor).ThrottleFor(speed, acceleration, MapVoltage(voltage_V));
  return CommandOf(throttle, command_unit);
}

}  // namespace odmc
