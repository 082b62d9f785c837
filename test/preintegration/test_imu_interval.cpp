#include <gtest/gtest.h>

#include <cmath>

#include "odmc/math/so3.h"
#include "odmc/preintegration/imu_interval.h"

namespace odmc {
namespace test {
namespace {

using Eigen::Vector3d;

constexpr double kHole = 0.06;

Vector3d RateAt(double t) {
  return {3.0 * std::sin(9.0 * t), -2.0 + 4.0 * t, 5.0 * std::cos(7.0 * t)};
}

Ring<ImuSample> Samples(double from, double to, double step, const Vector3d& bias, int hole = 0,
                        int hole_end = 0) {
  Ring<ImuSample> samples;
  for (int i = 0; from + step * i <= to + 1e-9; ++i) {
    if (i >= hole && i < hole_end) continue;
    const double t = from + step * i;
    ImuSample s;
    s.stamp = FromSeconds(t);
    s.gyro_I = RateAt(t) + bias;
    s.specific_force_I = Vector3d(t, 2.0 * t, 9.8);
    samples.push_back(s);
  }
  return samples;
}

Eigen::Quaterniond TrueTurn(double from, double to) {
  Eigen::Quaterniond q = Eigen::Quaterniond::Identity();
  const int n = 20000;
  const double step = (to - from) / n;
  for (int i = 0; i < n; ++i) q = (q * Exp(step * RateAt(from + (i + 0.5) * step))).normalized();
  return q;
}

TEST(PreintegrateImu, FollowsTheTrueTurn) {
  const Vector3d bias(0.05, -0.03, 0.02);
  const auto samples = Samples(0.0, 0.2, 0.0025, bias);
  const auto z = PreintegrateImu(samples, FromSeconds(0.0513), FromSeconds(0.0713), bias, kHole);
  ASSERT_TRUE(z);
  EXPECT_TRUE(z->has_gyro);
  EXPECT_NEAR(z->dt, 0.02, 1e-12);
  EXPECT_LT(z->delta_q.angularDistance(TrueTurn(0.0513, 0.0713)), 1e-5);
  EXPECT_NEAR(z->delta_q.norm(), 1.0, 1e-14);
  // With bias, between samples.
  EXPECT_LT((z->gyro_at_end - RateAt(0.0713) - bias).norm(), 1e-3);
}

TEST(PreintegrateImu, DerivativeByTheBiasIsThatOfTheTurn) {
  const auto samples = Samples(0.0, 0.3, 0.0025, Vector3d::Zero());
  const Stamp from = FromSeconds(0.05), to = FromSeconds(0.15);
  const Vector3d at(0.1, -0.2, 0.3);
  const auto z = PreintegrateImu(samples, from, to, at, kHole);
  ASSERT_TRUE(z);
  constexpr double kStep = 1e-5;
  for (int i = 0; i < 3; ++i) {
    const Vector3d d = kStep * Vector3d::Unit(i);
    const auto plus = PreintegrateImu(samples, from, to, at + d, kHole);
    const auto minus = PreintegrateImu(samples, from, to, at - d, kHole);
    const Vector3d slope = (Log(z->delta_q.conjugate() * plus->delta_q) -
                            Log(z->delta_q.conjugate() * minus->delta_q)) /
                           (2.0 * kStep);
    EXPECT_LT((slope - z->d_bias.col(i)).norm(), 1e-7 * z->d_bias.norm());
  }
}

TEST(PreintegrateImu, ComposesOverNeighbouringIntervals) {
  const auto samples = Samples(0.0, 0.2, 0.0025, Vector3d::Zero());
  const auto whole =
      PreintegrateImu(samples, FromSeconds(0.05), FromSeconds(0.09), Vector3d::Zero(), kHole);
  const auto a =
      PreintegrateImu(samples, FromSeconds(0.05), FromSeconds(0.07), Vector3d::Zero(), kHole);
  const auto b =
      PreintegrateImu(samples, FromSeconds(0.07), FromSeconds(0.09), Vector3d::Zero(), kHole);
  ASSERT_TRUE(whole && a && b);
  EXPECT_LT(whole->delta_q.angularDistance(a->delta_q * b->delta_q), 1e-7);
  EXPECT_EQ(whole->num_samples, a->num_samples + b->num_samples);
}

TEST(PreintegrateImu, MeanSpecificForceIsThatOfTheInterval) {
  const auto samples = Samples(0.0, 0.2, 0.004, Vector3d::Zero());
  const auto z =
      PreintegrateImu(samples, FromSeconds(0.051), FromSeconds(0.061), Vector3d::Zero(), kHole);
  ASSERT_TRUE(z);
  EXPECT_TRUE(z->has_accelerometer);
  EXPECT_LT((z->mean_specific_force - Vector3d(0.056, 0.112, 9.8)).norm(), 1e-9);
}

TEST(PreintegrateImu, SaysWhichSensorIsThere) {
  auto samples = Samples(0.0, 0.2, 0.0025, Vector3d::Zero());
  for (ImuSample& s : samples) s.specific_force_I.reset();
  const auto gyro =
      PreintegrateImu(samples, FromSeconds(0.05), FromSeconds(0.06), Vector3d::Zero(), kHole);
  ASSERT_TRUE(gyro);
  EXPECT_TRUE(gyro->has_gyro);
  EXPECT_FALSE(gyro->has_accelerometer);
  samples = Samples(0.0, 0.2, 0.0025, Vector3d::Zero());
  samples[22].gyro_I.reset();  // one reading is missing in the middle
  const auto force =
      PreintegrateImu(samples, FromSeconds(0.05), FromSeconds(0.06), Vector3d::Zero(), kHole);
  ASSERT_TRUE(force);
  EXPECT_FALSE(force->has_gyro);
  EXPECT_TRUE(force->has_accelerometer);
}

TEST(PreintegrateImu, GivesNothingAcrossAHoleOrWhereSamplesDoNotReach) {
  const auto samples = Samples(1.0, 1.2, 0.0025, Vector3d::Zero());
  const Vector3d zero = Vector3d::Zero();
  EXPECT_FALSE(PreintegrateImu(samples, FromSeconds(0.99), FromSeconds(1.01), zero, kHole));
  EXPECT_FALSE(PreintegrateImu(samples, FromSeconds(1.195), FromSeconds(1.205), zero, kHole));
  EXPECT_FALSE(PreintegrateImu({}, FromSeconds(1.0), FromSeconds(1.01), zero, kHole));
  const auto with_hole = Samples(1.0, 1.2, 0.0025, Vector3d::Zero(), 20, 50);
  EXPECT_FALSE(PreintegrateImu(with_hole, FromSeconds(1.06), FromSeconds(1.07), zero, kHole));
  EXPECT_TRUE(PreintegrateImu(with_hole, FromSeconds(1.15), FromSeconds(1.16), zero, kHole));
}

}  // namespace
}  // namespace test
}  // namespace odmc
