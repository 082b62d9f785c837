#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <utility>

#include "odmc/attribution/attribution.h"
#include "odmc/attribution/structure.h"
#include "odmc/attribution/unexplained.h"
#include "odmc/math/gaussian.h"

namespace odmc {
namespace test {
namespace {

constexpr int kSamples = 1000;

ThinnedFlight Hover() {
  FlightMotion motion;
  motion.step_s = ThinnedFlight::kStep_s;
  for (int i = 0; i < kSamples; ++i) {
    FilteredMotion sample;
    sample.t_s = i * motion.step_s;
    sample.R_WS.setIdentity();
    sample.p_WS.setZero();
    sample.v_WS.setZero();
    sample.w_S.setZero();
    sample.rotors.speed_squared = RotorVector::Ones(4);
    sample.follows = i > 0;
    motion.samples.push_back(sample);
  }
  return ThinnedFlight(std::move(motion), BlockSplit());
}

/// Standard deviation 1: as a slow error of the attitude, or a gust.
Eigen::VectorXd Slow(int n, int seed, double correlation_s = 0.2) {
  Gaussian random(seed, 1);
  const double decay = std::exp(-ThinnedFlight::kStep_s / correlation_s);
  Eigen::VectorXd x(n);
  double value = 0.0;
  for (int i = 0; i < n; ++i) {
    value = decay * value + std::sqrt(1.0 - decay * decay) * random.Next();
    x[i] = value;
  }
  return x;
}

Eigen::VectorXd White(int n, int seed) {
  Gaussian random(seed, 2);
  Eigen::VectorXd x(n);
  for (int i = 0; i < n; ++i) x[i] = random.Next();
  return x;
}

/// Forces of 1 N are no lean of it.
Vehicle Light() {
  Vehicle vehicle;
  vehicle.mass_kg = 0.1;
  return vehicle;
}

/// Structure of a force in x of which one sensor shows `one` of a slow force, the other `other`.
ChannelStructure Measured(const ThinnedFlight& flight, int seed, const Eigen::VectorXd& one,
                          const Eigen::VectorXd& other) {
  const int n = flight.size();
  ResidualModel::Wrenches residual = ResidualModel::Wrenches::Zero(n, kNumChannels);
  Eigen::MatrixX3d again = Eigen::MatrixX3d::Zero(n, 3);
  residual.col(0) = one + White(n, seed) + Eigen::VectorXd::Constant(n, 5.0);  // a bias
  again.col(0) = other + 2.0 * White(n, seed + 1000);
  return StructureByChannel(flight, residual, 3, {again}, Light()).front();
}

TEST(SharedStructure, ForcesAreInBothMeasurementsAndErrorsInOne) {
  const ThinnedFlight flight = Hover();
  const AttributionOptions options;
  const int n = flight.size();
  int forces = 0, errors = 0;
  for (int seed = 0; seed < 20; ++seed) {
    const Eigen::VectorXd force = Slow(n, seed);
    const ChannelStructure felt = Measured(flight, seed, force, force);
    ASSERT_LT(felt.whiteness.p, options.whiteness_p);
    ASSERT_TRUE(felt.shared);
    // Some of the white noise counts as structure, so 1 is not reached.
    EXPECT_GT(felt.shared->share, 4.0 * felt.shared->sigma) << seed;
    EXPECT_LT(felt.shared->share, 1.0 + 4.0 * felt.shared->sigma) << seed;
    forces += IsStructured(felt, options) ? 1 : 0;
    const ChannelStructure own = Measured(flight, seed, force, Slow(n, seed + 500));
    ASSERT_LT(own.whiteness.p, options.whiteness_p);
    EXPECT_NEAR(own.shared->share, 0.0, 4.0 * own.shared->sigma) << seed;
    errors += IsSensorNoise(own, options) ? 1 : 0;
  }
  EXPECT_EQ(forces, 20);
  EXPECT_GE(errors, 16);
}

TEST(SharedStructure, WhatTheMotionIsTooNoisyForIsAForce) {
  const ThinnedFlight flight = Hover();
  const Eigen::VectorXd force = Slow(flight.size(), 3);
  const ChannelStructure felt = Measured(flight, 3, force, force + 30.0 * White(flight.size(), 77));
  EXPECT_GT(felt.shared->sigma, 0.3);
  EXPECT_TRUE(IsStructured(felt, AttributionOptions()));
}

TEST(SharedStructure, OneMeasurementSaysNothing) {
  const ThinnedFlight flight = Hover();
  ResidualModel::Wrenches residual = ResidualModel::Wrenches::Zero(flight.size(), kNumChannels);
  residual.col(0) = Slow(flight.size(), 1);
  const auto channels = StructureByChannel(flight, residual, 3, ResidualContext(), Light());
  EXPECT_FALSE(channels.front().shared);
  EXPECT_TRUE(IsStructured(channels.front(), AttributionOptions()));
}

/// Structure of a channel of the force, of slow and quick parts, measured by the motion alone, of a
/// vehicle of 10 N.
ChannelStructure OfForce(Eigen::Index channel, double slow_N, double quick_N, int seed,
                         double white_N) {
  const ThinnedFlight flight = Hover();
  const int n = flight.size();
  ResidualModel::Wrenches residual = ResidualModel::Wrenches::Zero(n, kNumChannels);
  residual.col(channel) =
      slow_N * Slow(n, seed, 4.0) + quick_N * Slow(n, seed + 100) + white_N * White(n, seed);
  Vehicle vehicle;
  vehicle.mass_kg = 10.0 / vehicle.gravity_m_s2;
  return StructureByChannel(flight, residual, 3, ResidualContext(),
                            vehicle)[static_cast<size_t>(channel)];
}

ChannelStructure Lateral(double slow_N, double quick_N, int seed, double white_N = 0.1) {
  return OfForce(0, slow_N, quick_N, seed, white_N);
}

ChannelStructure AlongZ(double slow_N, double quick_N, int seed, double white_N = 0.03) {
  return OfForce(2, slow_N, quick_N, seed, white_N);
}

TEST(Lean, ASlowForceOfADegreeMayBeTheOdometrys) {
  const AttributionOptions options;
  int leans = 0, forces = 0, quick = 0;
  for (int seed = 0; seed < 20; ++seed) {
    const ChannelStructure lean = Lateral(0.1, 0.0, seed);
    ASSERT_LT(lean.whiteness.p, options.whiteness_p) << seed;
    leans += IsStructured(lean, options) ? 0 : 1;
    forces += IsStructured(Lateral(0.5, 0.0, seed), options) ? 1 : 0;  // three degrees
    quick +=
        IsStructured(Lateral(0.02, 0.07, seed, 0.01), options) ? 1 : 0;  // no attitude errs so fast
  }
  EXPECT_GE(leans, 18);
  EXPECT_GE(forces, 18);
  EXPECT_EQ(quick, 20);
}

// The lean is far surer; it is no structure that asks for an effect.
TEST(WhereStructured, NamesAChannelThatIsStructured) {
  ChannelStructure lean = Lateral(0.1, 0.0, 3);
  lean.whiteness.p = 1e-40;
  ASSERT_FALSE(IsStructured(lean, AttributionOptions()));
  ChannelStructure torque;
  torque.name = "torque_z";
  torque.dependence = {{"time", 0.1}};
  torque.whiteness.p = 1e-8;
  torque.whiteness.structured_share = 0.6;
  ASSERT_TRUE(IsStructured(torque, AttributionOptions()));
  const ThinnedFlight flight = Hover();
  const ResidualModel::Wrenches residual =
      ResidualModel::Wrenches::Ones(flight.size(), kNumChannels);
  const std::string where = WhereStructured({lean, torque}, flight, residual, AttributionOptions());
  EXPECT_EQ(where.substr(0, 8), "torque_z") << where;
}

TEST(Lean, WhatBothSensorsShowIsAForce) {
  const ThinnedFlight flight = Hover();
  const int n = flight.size();
  Vehicle vehicle;
  vehicle.mass_kg = 100.0 / vehicle.gravity_m_s2;  // 1 N is 0.01 of it
  int forces = 0, leans = 0;
  for (int seed = 0; seed < 20; ++seed) {
    const Eigen::VectorXd force = Slow(n, seed, 2.0);
    for (const bool both : {true, false}) {
      ResidualModel::Wrenches residual = ResidualModel::Wrenches::Zero(n, kNumChannels);
      Eigen::MatrixX3d again = Eigen::MatrixX3d::Zero(n, 3);
      residual.col(0) = force + White(n, seed);
      again.col(0) = (both ? 1.0 : 0.0) * force + 2.0 * White(n, seed + 1000);
      const ChannelStructure channel =
          StructureByChannel(flight, residual, 3, {again}, vehicle).front();
      (both ? forces : leans) += IsLean(channel, AttributionOptions()) != both ? 1 : 0;
    }
  }
  EXPECT_GE(forces, 18);
  EXPECT_GE(leans, 18);
}

TEST(ThrustWander, ASlowForceOfHalfAPerCentOfTheWeightIsNoEffect) {
  const AttributionOptions options;
  int wanders = 0, forces = 0, quick = 0;
  for (int seed = 0; seed < 20; ++seed) {
    const ChannelStructure wander = AlongZ(0.03, 0.0, seed);
    ASSERT_LT(wander.whiteness.p, options.whiteness_p) << seed;
    wanders += IsStructured(wander, options) ? 0 : 1;
    forces += IsStructured(AlongZ(0.2, 0.0, seed), options) ? 1 : 0;  // two per cent
    quick += IsStructured(AlongZ(0.005, 0.02, seed, 0.003), options) ? 1 : 0;
  }
  EXPECT_GE(wanders, 18);
  EXPECT_EQ(forces, 20);
  EXPECT_EQ(quick, 20);
}

}  // namespace
}  // namespace test
}  // namespace odmc
