#pragma once

#include <optional>
#include <string>
#include <vector>

#include "odmc/sensing/command_unit.h"

namespace odmc {

/// Rotor with motor, S_0 v_a being its drive:   dOmega/dt = drive - S1 Omega - S2 Omega²
/// Solved exactly for a constant drive.                                   model.md section 11, (11)
struct MotorDynamics {
  double S1 = 40.0;  ///< back EMF and friction over inertia [1/s], >= 0
  double S2 = 0.0;   ///< k_m over inertia [1/rad], >= 0; S1 + S2 > 0

  /// Speed that `drive` [rad/s²] holds, 0 where it is not positive.
  double SteadySpeed(double drive) const;
  /// What it takes to turn at `speed` and accelerate [rad/s²].
  double DriveFor(double speed, double acceleration = 0.0) const {
    return acceleration + (S1 + S2 * speed) * speed;
  }
  /// Speed `dt` after `speed`, both >= 0.
  double After(double speed, double drive, double dt) const;
  double TimeConstant(double speed) const { return 1.0 / (S1 + 2.0 * S2 * speed); }
};

/// `speed` after `dt` [s] at the voltage that holds `steady` [rad/s]: (steady - Omega) / (Omega +
/// steady + S1/S2) decays as exp(-(S1 + 2 S2 steady) t).
double MotorSpeedAfter(double speed, double steady, double S1, double S2, double dt);
/// Its rate of change at that voltage [rad/s²].
inline double MotorSpeedRate(double speed, double steady, double S1, double S2) {
  return (steady - speed) * (S1 + S2 * (steady + speed));
}

/// Drive of throttle x at battery voltage V:   root V sqrt(x - start) + linear x + constant
/// The paper's input map with its dimensions put right.                   model.md section 11, (12)
struct EscMap {
  double root = 0.0;      ///< S_0 alpha [rad/s²/V]
  double linear = 0.0;    ///< S_0 beta [rad/s²]
  double constant = 0.0;  ///< -S_0 beta U_b [rad/s²]
  double start = 0.0;     ///< U_a as throttle; below it the root is 0

  double Drive(double throttle, double voltage_V) const;
  /// Throttle that gives `drive`; not limited to [0, 1]. `start` where no throttle gives so little.
  double ThrottleFor(double drive, double voltage_V) const;
};

/// One rotor from command to speed.
struct Motor {
  EscMap esc;
  MotorDynamics dynamics;
  double delay_s = 0.0;  ///< from command to the first change of speed

  double SteadySpeed(double throttle, double voltage_V) const {
    return dynamics.SteadySpeed(esc.Drive(throttle, voltage_V));
  }
  /// Throttle to turn at `speed` and accelerate at this voltage, clamped to [0, 1].
  double ThrottleFor(double speed, double acceleration, double voltage_V) const;
};

/// A value with its standard deviation.
struct MeasuredValue {
  double value = 0.0;
  double sigma = 0.0;
};

/// The calibrated actuators of a vehicle: what `calibrate_actuator` found.
struct Actuator {
  CommandUnit command_unit = CommandUnit::kFraction;
  bool uses_voltage = true;    ///< false: voltage was not known, the map holds for that of the run
  bool knows_dynamics = true;  ///< false: from steady readings; S_1, S_2 and the delay are guesses
  std::vector<Motor> motors;   ///< one for all rotors, or one each in the vehicle file's order
  double sigma_steady_rad_s = 0.0, sigma_response_rad_s = 0.0;  ///< error of a free run, RMS
  std::optional<MeasuredValue> k_f;  ///< of one rotor [N s²], where a stand measured thrust
  std::optional<MeasuredValue> k_m;  ///< of one rotor [N m s²], where torque or inertia was known

  /// Whether there is one motor for all rotors or one for each.
  bool Fits(int num_rotors) const {
    return motors.size() == 1 || static_cast<int>(motors.size()) == num_rotors;
  }
  const Motor& MotorOf(int rotor) const {
    return motors[motors.size() == 1 ? 0 : static_cast<size_t>(rotor)];
  }
  /// Voltage as the map takes it.
  double MapVoltage(double voltage_V) const { return uses_voltage ? voltage_V : 1.0; }
  /// Command that turns `rotor` at `speed` [rad/s] and accelerates it [rad/s²] at this voltage.
  double CommandFor(int rotor, double speed, double acceleration, double voltage_V) const;
};

}  // namespace odmc
