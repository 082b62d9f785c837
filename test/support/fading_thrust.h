#pragma once

#include <vector>

#include "odmc/attribution/ranked_effect.h"
#include "odmc/model/dynamic_model.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace test {

/// A vehicle that carries an IMU.
inline Vehicle VehicleWithImu() {
  Vehicle vehicle = NominalVehicle();
  vehicle.imu = SensorMount();
  return vehicle;
}

/// A flight of VehicleWithImu() on which the thrust coefficient falls slowly, by 1 % in 5 s.
/// Odometry shows it; an accelerometer is too noisy to.
inline FlightLog FlightOfFadingThrust(bool with_accelerometer, int seed, double duration_s) {
  Vehicle flown = VehicleWithImu();
  flown.effects.emplace_back("thrust_drift");
  const DynamicModel model(flown, flown.effects);
  ModelValues truth = DefaultTruth(model);
  truth[model.IndexOf("thrust_drift.rate")] = -2e-3;
  SimulationOptions options;
  options.trajectory = "octo";
  options.duration_s = duration_s;
  options.log_rate_hz = 100.0;
  options.seed = seed;
  SimulationNoise noise;
  noise.position_m = 0.002;
  noise.velocity_m_s = 0.005;
  noise.force_N = 0.002;
  noise.imu = with_accelerometer;
  noise.accelerometer_noise_density = 0.2;
  noise.gyro_noise_density = 1e-3;
  FlightLog log = Simulate(model, truth, options, noise).log;
  log.file = "fading" + std::to_string(seed);
  return log;
}

/// What a ranking says of that [nats].
inline double ScoreOfFadingThrust(const std::vector<RankedEffect>& ranking) {
  for (const RankedEffect& ranked : ranking) {
    if (ranked.name == "thrust_drift") return ranked.score;
  }
  return 0.0;
}

}  // namespace test
}  // namespace odmc
