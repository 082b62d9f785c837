#pragma once

#include <cmath>

#include "odmc/effects/effects.h"
#include "odmc/model/dynamic_model.h"
#include "odmc/sim/simulator.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace test {

/// `n` rotors evenly on a circle, spins in turn; the nominal vehicle grown to carry them.
inline Vehicle RoundVehicle(int n) {
  Vehicle vehicle = NominalVehicle();
  vehicle.rotors.clear();
  const double radius = 0.028 * n;
  for (int i = 0; i < n; ++i) {
    const double angle = 2.0 * M_PI * (i + 0.5) / n;
    vehicle.rotors.push_back({{radius * std::cos(angle), radius * std::sin(angle), 0.0},
                              i % 2 == 0 ? -1.0 : 1.0,
                              0.0635});
  }
  vehicle.mass_kg *= n / 4.0;
  vehicle.inertia_kg_m2 *= n / 4.0;
  return vehicle;
}

/// A hexarotor of 3.5 kg and 0.7 m, whose rotors hardly differ from each other in gentle flight.
inline Vehicle HeavyHexa() {
  Vehicle vehicle = RoundVehicle(6);
  vehicle.mass_kg = 3.5;
  vehicle.inertia_kg_m2 = {0.082, 0.088, 0.150};
  for (Rotor& rotor : vehicle.rotors) {
    rotor.p_BP *= 0.35 / rotor.p_BP.norm();
    rotor.radius_m = 0.14;
  }
  vehicle.parameters["thrust.k_f"].value = 2.5e-5;
  vehicle.parameters["rotor_torque.k_m"].value = 5e-7;
  return vehicle;
}

/// A flight of the vehicle with the default noise.
inline FlightLog Flown(const Vehicle& vehicle, const std::string& trajectory, double duration_s,
                       int seed = 3, double ground_s = 0.0) {
  const DynamicModel model(vehicle, vehicle.effects);
  SimulationOptions options;
  options.trajectory = trajectory;
  options.duration_s = duration_s;
  options.log_rate_hz = 200.0;
  options.seed = seed;
  options.ground_s = ground_s;
  return Simulate(model, model.InitialValues(), options).log;
}

/// The vehicle with its rotors (place and spin) listed in another order: entry j is the old one
/// `order[j]`.
template <typename Order>
Vehicle Reordered(const Vehicle& vehicle, const Order& order) {
  Vehicle result = vehicle;
  for (size_t j = 0; j < result.rotors.size(); ++j) {
    result.rotors[j] = vehicle.rotors[static_cast<size_t>(order[j])];
  }
  return result;
}

/// The vehicle with the spins of the bits of `pattern`.
inline Vehicle Respun(const Vehicle& vehicle, unsigned pattern) {
  Vehicle result = vehicle;
  for (size_t j = 0; j < result.rotors.size(); ++j) {
    result.rotors[j].spin = (pattern >> j & 1U) != 0U ? 1.0 : -1.0;
  }
  return result;
}

}  // namespace test
}  // namespace odmc
