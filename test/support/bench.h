#pragma once

#include <cmath>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "odmc/actuator/bench_run.h"
#include "odmc/actuator/speed_predictor.h"

namespace odmc::test {

/// A motor like that of a 5-inch quadrotor on 4S.
inline Motor TypicalMotor() {
  Motor motor;
  motor.dynamics = {24.0, 0.006};
  motor.esc = {3200.0, 12000.0, -9000.0, -0.25};
  motor.delay_s = 0.006;
  return motor;
}

/// What is wrong with a bench.
struct BenchErrors {
  double noise_rad_s = 2.0;
  double quantum_rad_s = 0.0;  ///< readings are multiples of it
  double outlier_share = 0.0;  ///< of readings, anywhere between 0 and twice the speed
  double zero_share = 0.0;     ///< of readings that are missed
  int missing_step = -1;       ///< the motor does not follow this step of the staircase
};

/// Steps of throttle up and down, 2.5 s each, sampled at `rate_hz`; the battery sags from 16.2 V.
inline BenchRun StepBench(const Motor& motor, const BenchErrors& errors, int seed,
                          double rate_hz = 200.0) {
  BenchRun run;
  run.file = "bench.csv";
  run.command_unit = CommandUnit::kMicroseconds;
  run.throttle.resize(1);
  run.speed_rad_s.resize(1);
  const std::vector<double> steps = {0.1, 0.2, 0.3, 0.45, 0.6, 0.5, 0.35, 0.25, 0.4, 0.55, 0.15};
  std::mt19937 random(static_cast<unsigned>(seed));
  std::normal_distribution<double> noise(0.0, errors.noise_rad_s);
  std::uniform_real_distribution<double> share(0.0, 1.0);
  SpeedPredictor truth(motor);
  constexpr double kStep_s = 2.5;
  for (double t = 0.0; t < kStep_s * static_cast<double>(steps.size()); t += 1.0 / rate_hz) {
    const auto step = static_cast<int>(t / kStep_s);
    const bool missed = step == errors.missing_step;
    const double throttle = steps[static_cast<size_t>(step)];
    const double voltage = 16.2 - 0.02 * t - 1.2 * throttle;
    truth.Command(t, missed ? steps[static_cast<size_t>(step - 1)] : throttle, voltage);
    double speed = truth.At(t) + noise(random);
    if (errors.quantum_rad_s > 0.0)
      speed = errors.quantum_rad_s * std::round(speed / errors.quantum_rad_s);
    if (share(random) < errors.outlier_share) speed *= 2.0 * share(random);
    if (share(random) < errors.zero_share) {
      speed = std::numeric_limits<double>::quiet_NaN();
      ++run.zero_speed;
    }
    run.t_s.push_back(t);
    run.throttle[0].push_back(throttle);
    run.speed_rad_s[0].push_back(speed);
    run.voltage_V.push_back(voltage);
  }
  run.rows = static_cast<long>(run.t_s.size());
  return run;
}

}  // namespace odmc::test
