#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "odmc/attribution/force_blend.h"

namespace odmc {
namespace {

using Eigen::Index;
using Eigen::VectorXd;

constexpr int kSamples = 1500;
constexpr int kGapAt = 700;
constexpr double kStep_s = 0.04;

std::vector<bool> WithAGap() {
  std::vector<bool> follows(kSamples, true);
  follows[0] = follows[kGapAt] = false;
  return follows;
}

/// Two measurements of one force: white noise by the accelerometer, the derivative of a noisy
/// velocity by the motion.
struct Measured {
  explicit Measured(double size_of_force, unsigned seed = 3) {
    std::mt19937 random(seed);
    std::normal_distribution<double> normal;
    force.resize(kSamples);
    felt_noise.resize(kSamples);
    motion_noise.resize(kSamples);
    double before = normal(random);
    for (Index i = 0; i < kSamples; ++i) {
      const double t_s = kStep_s * static_cast<double>(i), velocity = normal(random);
      force[i] = size_of_force * std::sin(2.0 * M_PI * 0.1 * t_s);
      felt_noise[i] = 0.5 + 0.3 * normal(random);  // 0.5: a bias
      motion_noise[i] = 0.5 * (velocity - before);
      before = velocity;
    }
  }
  VectorXd felt() const { return force + felt_noise; }
  VectorXd by_motion() const { return force + motion_noise; }
  ForceBlend Fit() const {
    return {WithAGap(), std::vector<bool>(kSamples, true), felt(), by_motion()};
  }

  VectorXd force, felt_noise, motion_noise;
};

/// Of means over two seconds.
double SlowVariance(const VectorXd& x) {
  constexpr Index kBlock = 50;
  double sum = 0.0, square = 0.0, count = 0.0;
  for (Index i = 0; i + kBlock <= x.size(); i += kBlock) {
    const double mean = x.segment(i, kBlock).mean();
    sum += mean;
    square += mean * mean;
    ++count;
  }
  return square / count - std::pow(sum / count, 2);
}

double Variance(const VectorXd& x) { return (x.array() - x.mean()).square().mean(); }

TEST(ForceBlend, PassesWhatBothFeel) {
  const Measured m(2.0);
  const ForceBlend blend = m.Fit();
  EXPECT_LT((blend.Blend(m.force, m.force) - m.force).cwiseAbs().maxCoeff(), 1e-12);
}

TEST(ForceBlend, IsBetterThanEither) {
  for (const double size : {0.0, 0.5, 5.0}) {
    const Measured m(size);
    const VectorXd error = m.Fit().Blend(m.felt(), m.by_motion()) - m.force;
    EXPECT_LT(Variance(error), 0.9 * Variance(m.felt_noise)) << size;
    EXPECT_LT(Variance(error), 0.5 * Variance(m.motion_noise)) << size;
    EXPECT_LT(SlowVariance(error), 0.3 * SlowVariance(m.felt_noise)) << size;
  }
}

TEST(ForceBlend, WeighsByNoiseAndNotByForce) {
  const auto none = Measured(0.0).Fit().felt_weight();
  const auto large = Measured(5.0).Fit().felt_weight();
  EXPECT_GT(none.front(), 0.7);  // quick: the accelerometer
  EXPECT_LT(none.back(), 0.2);   // slow: the motion
  // The octaves in which there is no force.
  for (size_t b = 0; b < 3; ++b) EXPECT_NEAR(large[b], none[b], 0.1) << b;
}

TEST(ForceBlend, DoesNotReachAcrossGaps) {
  const Measured m(1.0);
  const ForceBlend blend = m.Fit();
  VectorXd other = m.felt();
  other.tail(kSamples - kGapAt).array() += 100.0;
  const VectorXd one = blend.Blend(m.felt(), m.by_motion());
  const VectorXd two = blend.Blend(other, m.by_motion());
  EXPECT_EQ((one - two).head(kGapAt).cwiseAbs().maxCoeff(), 0.0);
}

}  // namespace
}  // namespace odmc
