#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "odmc/estimator/options.h"
#include "odmc/sim/simulator.h"

namespace odmc {

/// A Monte Carlo of simulated flights, calibrated from wrong starts.
struct RecoveryOptions {
  SimulationOptions simulation;  ///< seed is that of the first flight
  SimulationNoise noise;
  EstimatorOptions estimator = OfflineOptions();
  int seeds = 20;             ///< flights, >= 1
  int jobs = 1;               ///< at a time, >= 1
  double start_offset = 0.3;  ///< starts are off by up to this share of the truth
  double inertia_start_offset = 0.5;
  double start_thrust_factor = 0.0;  ///< > 0: k_f starts at this times the truth
};

/// How one parameter came back over all flights.
struct ParameterRecovery {
  std::string full_name, unit;
  double truth = 0.0;
  double median_error = 0.0;                    ///< of |error| [unit]
  std::optional<double> median_relative_error;  ///< where the truth is away from zero
  double median_error_over_sigma = 0.0;
  double coverage_3sigma = 0.0;   ///< share of flights with the truth inside
  double observable_share = 0.0;  ///< of flights
};

/// How all parameters came back, over all flights.
struct Recovery {
  std::vector<ParameterRecovery> parameters;  ///< the estimated ones
  double pooled_coverage_3sigma = 0.0;
};

/// The vehicle as recovery estimates it: all parameters free but the rotor torque and the
/// extrinsics, which are frozen at the truth.
Vehicle RecoveryVehicle(const Vehicle& vehicle);

/// The vehicle with its estimated parameters started wrong: off by up to the options' shares,
/// uniformly by seed. Places and angles (unit m or rad) and what is truly zero start at their
/// prior. No prior is tighter than its own offset.
Vehicle StartWrong(const DynamicModel& model, const ModelValues& truth,
                   const RecoveryOptions& options, int seed);

/// Flies, calibrates and compares. The truth is DefaultTruth() of the vehicle.
/// @param vehicle its effects are the model's; see RecoveryVehicle()
/// @param progress called with the share done (0 to 1), one call at a time; may be empty
/// @throws std::runtime_error, std::invalid_argument of the first flight that fails
Recovery Recover(const Vehicle& vehicle, const RecoveryOptions& options,
                 const std::function<void(double)>& progress = {});

}  // namespace odmc
