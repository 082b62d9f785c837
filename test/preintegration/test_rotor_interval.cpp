#include <gtest/gtest.h>

#include <cmath>

#include "odmc/preintegration/rotor_interval.h"

namespace odmc {
namespace test {
namespace {

constexpr double kHole = 0.06;

RotorVector Two(double a, double b) {
  RotorVector v(2);
  v << a, b;
  return v;
}

Ring<RotorSample> Samples(double from, double to, double step, double (*speed)(double),
                          int hole = 0, int hole_end = 0) {
  Ring<RotorSample> samples;
  for (int i = 0; from + step * i <= to + 1e-9; ++i) {
    if (i >= hole && i < hole_end) continue;
    const double t = from + step * i;
    samples.push_back({FromSeconds(t), Two(speed(t), 500.0)});
  }
  return samples;
}

double Ramp(double t) { return 1000.0 + 2000.0 * t; }

TEST(ReduceRotors, AveragesTheSquareNotTheSpeed) {
  Ring<RotorSample> samples;
  for (int i = 0; i <= 4; ++i) {
    samples.push_back({FromSeconds(1.0 + 0.0025 * i), Two(i % 2 == 0 ? 900.0 : 1100.0, 1000.0)});
  }
  const auto interval = ReduceRotors(samples, FromSeconds(1.0), FromSeconds(1.01), kHole);
  ASSERT_TRUE(interval);
  EXPECT_NEAR(interval->mean.speed[0], 1000.0, 1e-9);
  EXPECT_NEAR(interval->mean.speed_squared[0], 0.5 * (900.0 * 900.0 + 1100.0 * 1100.0), 1e-6);
  EXPECT_GT(interval->mean.speed_squared[0], interval->mean.speed[0] * interval->mean.speed[0]);
  EXPECT_NEAR(interval->mean.speed_squared[1], 1e6, 1e-6);
}

TEST(ReduceRotors, ConvergesToTheIntegralOfTheSquare) {
  const auto samples = Samples(0.0, 0.02, 0.0001, Ramp);
  const auto interval = ReduceRotors(samples, FromSeconds(0.005), FromSeconds(0.015), kHole);
  ASSERT_TRUE(interval);
  const double a = Ramp(0.005), b = Ramp(0.015);
  EXPECT_NEAR(interval->mean.speed_squared[0], (a * a + a * b + b * b) / 3.0, 0.05);
}

TEST(ReduceRotors, InterpolatesItsEnds) {
  // Samples every 4 ms; the interval starts and ends between them.
  const auto samples = Samples(0.0, 0.04, 0.004, Ramp);
  const auto interval = ReduceRotors(samples, FromSeconds(0.009), FromSeconds(0.019), kHole);
  ASSERT_TRUE(interval);
  EXPECT_NEAR(interval->start.speed[0], Ramp(0.009), 1e-9);
  EXPECT_NEAR(interval->start.speed_squared[0], Ramp(0.009) * Ramp(0.009), 1e-6);
  EXPECT_NEAR(interval->mean.speed[0], Ramp(0.014), 1e-9);
  EXPECT_NEAR(interval->mean.acceleration[0], 2000.0, 1e-6);
  const double rate = (Ramp(0.019) * Ramp(0.019) - Ramp(0.009) * Ramp(0.009)) / 0.01;
  EXPECT_NEAR(interval->mean.speed_squared_rate[0], rate, 1e-3);
  EXPECT_NEAR(interval->mean.acceleration[1], 0.0, 1e-9);
}

TEST(ReduceRotors, WorksBetweenTwoSamples) {
  const auto samples = Samples(0.0, 0.04, 0.02, Ramp);
  const auto interval = ReduceRotors(samples, FromSeconds(0.005), FromSeconds(0.015), kHole);
  ASSERT_TRUE(interval);
  EXPECT_GE(interval->num_samples, 1);
  EXPECT_NEAR(interval->mean.speed[0], Ramp(0.01), 1e-9);
}

TEST(ReduceRotors, IsAdditiveOverNeighbouringIntervals) {
  const auto samples = Samples(0.0, 0.05, 0.003, Ramp);
  const auto whole = ReduceRotors(samples, FromSeconds(0.01), FromSeconds(0.03), kHole);
  const auto first = ReduceRotors(samples, FromSeconds(0.01), FromSeconds(0.02), kHole);
  const auto second = ReduceRotors(samples, FromSeconds(0.02), FromSeconds(0.03), kHole);
  ASSERT_TRUE(whole && first && second);
  EXPECT_NEAR(whole->mean.speed[0], 0.5 * (first->mean.speed[0] + second->mean.speed[0]), 1e-9);
  EXPECT_NEAR(whole->mean.acceleration[0],
              0.5 * (first->mean.acceleration[0] + second->mean.acceleration[0]), 1e-6);
}

TEST(ReduceRotors, GivesNothingAcrossAHole) {
  const auto samples = Samples(0.0, 0.2, 0.0025, Ramp, 20, 50);  // 77.5 ms
  EXPECT_FALSE(ReduceRotors(samples, FromSeconds(0.06), FromSeconds(0.07), kHole));
  EXPECT_FALSE(ReduceRotors(samples, FromSeconds(0.04), FromSeconds(0.05), kHole));
  EXPECT_TRUE(ReduceRotors(samples, FromSeconds(0.13), FromSeconds(0.14), kHole));
  EXPECT_TRUE(ReduceRotors(samples, FromSeconds(0.06), FromSeconds(0.07), 0.1));
}

TEST(ReduceRotors, GivesNothingWhereSamplesDoNotReach) {
  const auto samples = Samples(1.0, 1.1, 0.0025, Ramp);
  EXPECT_FALSE(ReduceRotors(samples, FromSeconds(0.995), FromSeconds(1.005), kHole));
  EXPECT_FALSE(ReduceRotors(samples, FromSeconds(1.095), FromSeconds(1.105), kHole));
  EXPECT_FALSE(ReduceRotors({}, FromSeconds(1.0), FromSeconds(1.01), kHole));
  EXPECT_TRUE(ReduceRotors(samples, FromSeconds(1.0), FromSeconds(1.01), kHole));
  EXPECT_TRUE(ReduceRotors(samples, FromSeconds(1.09), FromSeconds(1.1), kHole));
}

}  // namespace
}  // namespace test
}  // namespace odmc
