// Rotor speeds given all samples: nearer to the truth than the samples, and fit for a regression.

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "odmc/analysis/rotor_smoothing.h"

namespace odmc {
namespace {

constexpr double kStep_s = 0.004;

struct Speeds {
  std::vector<RotorSample> measured;
  std::vector<double> truth;
};

/// One rotor with a first-order lag behind a restless command.
Speeds Make(double noise_rad_s, int count, unsigned seed) {
  std::mt19937 engine(seed);
  std::normal_distribution<double> gaussian;
  Speeds speeds;
  double command = 1000.0, speed = 1000.0;
  for (int i = 0; i < count; ++i) {
    command += 0.01 * (1000.0 - command) + 3.0 * gaussian(engine);
    speed += kStep_s / 0.04 * (command - speed);
    RotorSample sample;
    sample.stamp = FromSeconds(kStep_s * i);
    sample.speed = RotorVector::Constant(1, speed + noise_rad_s * gaussian(engine));
    speeds.measured.push_back(sample);
    speeds.truth.push_back(speed);
  }
  return speeds;
}

TEST(RotorSmoothing, FindsTheNoise) {
  const RotorSpeedNoise noise = FitRotorSpeedNoise(Make(8.0, 4000, 1).measured);
  EXPECT_NEAR(noise.measurement_rad_s, 8.0, 0.5);
}

TEST(RotorSmoothing, ComesNearerToTheTruth) {
  const Speeds speeds = Make(8.0, 4000, 2);
  const std::vector<RotorSample> smooth = SmoothRotorSpeeds(speeds.measured);
  double square = 0.0;
  for (size_t i = 0; i < smooth.size(); ++i) {
    EXPECT_EQ(smooth[i].stamp, speeds.measured[i].stamp);
    square += std::pow(smooth[i].speed[0] - speeds.truth[i], 2);
  }
  EXPECT_LT(std::sqrt(square / static_cast<double>(smooth.size())), 4.0);
}

/// Slope of the true derivative on the seen one, over 40 ms: one for a regression without bias.
double Slope(const std::vector<RotorSample>& seen, const std::vector<double>& truth) {
  constexpr size_t kApart = 10;
  double xy = 0.0, xx = 0.0;
  for (size_t i = 0; i + kApart < seen.size(); ++i) {
    const double x = seen[i + kApart].speed[0] - seen[i].speed[0];
    xy += x * (truth[i + kApart] - truth[i]);
    xx += x * x;
  }
  return xy / xx;
}

TEST(RotorSmoothing, RemovesTheBiasOfARegressionOnDifferences) {
  const Speeds speeds = Make(8.0, 8000, 3);
  EXPECT_LT(Slope(speeds.measured, speeds.truth), 0.8);
  EXPECT_NEAR(Slope(SmoothRotorSpeeds(speeds.measured), speeds.truth), 1.0, 0.06);
}

TEST(RotorSmoothing, LeavesSpeedsWithoutNoiseAlone) {
  const Speeds speeds = Make(0.0, 2000, 4);
  const std::vector<RotorSample> smooth = SmoothRotorSpeeds(speeds.measured);
  for (size_t i = 0; i < smooth.size(); ++i) {
    EXPECT_NEAR(smooth[i].speed[0], speeds.truth[i], 0.5);
  }
}

TEST(RotorSmoothing, DoesNotReachAcrossAHole) {
  Speeds speeds = Make(2.0, 1000, 5);
  for (size_t i = 500; i < 1000; ++i) {
    speeds.measured[i].stamp += FromSeconds(3.0);
    speeds.measured[i].speed[0] += 500.0;
    speeds.truth[i] += 500.0;
  }
  const std::vector<RotorSample> smooth = SmoothRotorSpeeds(speeds.measured);
  EXPECT_NEAR(smooth[499].speed[0], speeds.truth[499], 6.0);
  EXPECT_NEAR(smooth[500].speed[0], speeds.truth[500], 6.0);
}

TEST(RotorSmoothing, TooFewSamplesStayAsTheyAre) {
  const Speeds speeds = Make(5.0, 5, 6);
  const std::vector<RotorSample> smooth = SmoothRotorSpeeds(speeds.measured);
  ASSERT_EQ(smooth.size(), 5u);
  for (size_t i = 0; i < 5; ++i) EXPECT_EQ(smooth[i].speed[0], speeds.measured[i].speed[0]);
  EXPECT_TRUE(SmoothRotorSpeeds({}).empty());
}

}  // namespace
}  // namespace odmc
