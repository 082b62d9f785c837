#pragma once

#include "odmc/model/vehicle.h"

namespace odmc {
namespace test {

/// Four rotors in the order front right, front left, rear left, rear right, spins +, -, +, -.
inline std::vector<Rotor> RotorCross(double x, double y, double radius) {
  return {{{x, -y, 0.0}, +1.0, radius},
          {{x, y, 0.0}, -1.0, radius},
          {{-x, y, 0.0}, +1.0, radius},
          {{-x, -y, 0.0}, -1.0, radius}};
}

inline std::vector<std::string> PaperEffects() {
  return {"thrust", "rotor_torque",      "drag",    "viscous_torque",
          "hvt",    "centre_of_gravity", "inertia", "gravity"};
}

/// The vehicle of all simulations of model.md (section 8), sensor at -l = (-30, 20, 40) mm from Bo.
/// k_f and k_m are stated as in a vehicle file; DefaultTruth() gives the other values of section 8.
inline Vehicle NominalVehicle() {
  Vehicle vehicle;
  vehicle.name = "generic";
  vehicle.mass_kg = 0.75;
  vehicle.inertia_kg_m2 = {2.5e-3, 2.1e-3, 4.3e-3};
  vehicle.rotors = RotorCross(0.095, 0.11, 0.0635);
  vehicle.odometry.p_BS = {-0.030, 0.020, 0.040};
  vehicle.effects = PaperEffects();
  vehicle.parameters["thrust.k_f"].value = 1.5e-6;
  vehicle.parameters["rotor_torque.k_m"].value = 2.1e-8;
  return vehicle;
}

/// A Crazyflie 2.1 with brushless motors (shared/data/imrc_cf21_brushless): 37 g. Its rotors stand
/// in the order front right (ccw), rear right (cw), rear left (ccw), front left (cw).
inline Vehicle NanoVehicle() {
  constexpr double kHalf = 0.0325, kRadius = 0.0275;
  Vehicle vehicle;
  vehicle.name = "nano";
  vehicle.mass_kg = 0.037;
  vehicle.inertia_kg_m2 = {16.57e-6, 16.66e-6, 29.26e-6};
  vehicle.rotors = {{{kHalf, -kHalf, 0.0}, -1.0, kRadius},
                    {{-kHalf, -kHalf, 0.0}, +1.0, kRadius},
                    {{-kHalf, kHalf, 0.0}, -1.0, kRadius},
                    {{kHalf, kHalf, 0.0}, +1.0, kRadius}};
  vehicle.effects = PaperEffects();
  vehicle.parameters["thrust.k_f"].value = 3.7e-8;
  vehicle.parameters["rotor_torque.k_m"].value = 2.2e-10;
  return vehicle;
}

}  // namespace test
}  // namespace odmc
