#include <gtest/gtest.h>

#include <cmath>

#include "odmc/estimator/noise_estimation.h"
#include "odmc/math/gaussian.h"

namespace odmc {
namespace {

/// What StreamNoise finds of rotor speeds with white noise, read in steps, at 100 Hz for 10 s; mean
/// of its looks after the first two seconds [rad/s].
double FoundNoise(double sigma_rad_s, double step_rad_s, int seed) {
  Gaussian random(seed, 0);
  StreamNoise noise(OdometryNoise{0.0, 0.0, 0.0, 0.0});
  double sum = 0.0;
  int looks = 0;
  for (int i = 0; i < 1000; ++i) {
    RotorSample sample;
    sample.stamp = FromSeconds(0.01 * i);
    sample.speed = RotorVector(4);
    for (int j = 0; j < 4; ++j) {
      const double true_rad_s = 1000.0 + 50.0 * std::sin(0.05 * i + j);
      const double read_rad_s = true_rad_s + sigma_rad_s * random.Next();
      sample.speed[j] =
          step_rad_s > 0.0 ? step_rad_s * std::round(read_rad_s / step_rad_s) : read_rad_s;
    }
    noise.Add(sample);
    noise.AdvanceTo(sample.stamp);
    if (i < 200) continue;
    sum += noise.rotor_speed();
    ++looks;
  }
  return sum / looks;
}

// Telemetry counts pulses, or the time between them. The noise of a torque is in the inertia.
// The states absorb some of the rotors' noise, so that less is left than it is said to be; what
// comes later has to show all the same.
TEST(ProcessNoise, RisesAfterACalmInWhichRotorNoiseWasAll) {
  ProcessNoiseEstimator noise(7.36, 0.145, 1.0);
  const double floor_Nm = 9.4e-5 * 7.36 * 0.145;  // times the root of a second
  std::mt19937 engine(5);
  std::normal_distribution<double> gaussian;
  const auto fly = [&](double of_torque, double duration_s) {
    constexpr double kStep_s = 0.01;
    const double rotors = std::sqrt(10.0) * floor_Nm / std::sqrt(kStep_s);
    for (int i = 0; i < static_cast<int>(duration_s / kStep_s); ++i) {
      IntervalResidual residual;
      residual.dt = kStep_s;
      residual.rotor_torque_Nm.setConstant(rotors);
      for (double& tau : residual.torque_Nm) {
        tau = 0.9 * rotors * gaussian(engine) +
              of_torque * floor_Nm / std::sqrt(kStep_s) * gaussian(engine);
      }
      noise.Add(residual, true);
      noise.Step();
    }
  };
  fly(0.0, 30.0);
  EXPECT_NEAR(noise.in_use().torque, 1.0, 0.5);
  fly(10.0, 60.0);  // 100 times the floor's density, for two thirds of the minute
  EXPECT_GT(noise.in_use().torque, 20.0);
}

TEST(StreamNoise, OfRotorSpeedsReadInStepsIncludesTheSteps) {
  for (const double step_rad_s : {0.0, 1.0, 4.0, 6.0, 10.0, 12.0}) {
    constexpr double kSigma_rad_s = 4.0;
    const double expected = std::hypot(kSigma_rad_s, step_rad_s / std::sqrt(12.0));
    EXPECT_NEAR(FoundNoise(kSigma_rad_s, step_rad_s, 3), expected, 0.06 * expected) << step_rad_s;
  }
}

}  // namespace
}  // namespace odmc
