#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "odmc/attribution/force_blend.h"

namespace odmc {
namespace {

using Eigen::Index;
using Eigen::MatrixX3d;

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
    force.resize(kSamples, 3);
    felt_noise.resize(kSamples, 3);
    motion_noise.resize(kSamples, 3);
    for (Index c = 0; c < 3; ++c) {
      double before = normal(random);
      for (Index i = 0; i < kSamples; ++i) {
        const double t_s = kStep_s * static_cast<double>(i), velocity = normal(random);
        force(i, c) = size_of_force * std::sin(2.0 * M_PI * (0.1 + 0.05 * c) * t_s);
        felt_noise(i, c) = 0.5 + 0.3 * normal(random);  // 0.5: a bias
        motion_noise(i, c) = 0.5 * (velocity - before);
        before = velocity;
      }
    }
  }
  MatrixX3d felt() const { return force + felt_noise; }
  MatrixX3d by_motion() const { return force + motion_noise; }
  ForceBlend Fit() const {
    return {WithAGap(), std::vector<bool>(kSamples, true), felt(), by_motion()};
  }

  MatrixX3d force, felt_noise, motion_noise;
};

/// Of means over two seconds.
double SlowVariance(const MatrixX3d& x) {
  constexpr Index kBlock = 50;
  double sum = 0.0, square = 0.0, count = 0.0;
  for (Index i = 0; i + kBlock <= x.rows(); i += kBlock) {
    const double mean = x.col(0).segment(i, kBlock).mean();
    sum += mean;
    square += mean * mean;
    ++count;
  }
  return square / count - std::pow(sum / count, 2);
}

double Variance(const MatrixX3d& x) { return (x.col(0).array() - x.col(0).mean()).square().mean(); }

TEST(ForceBlend, PassesWhatBothFeel) {
  const Measured m(2.0);
  const ForceBlend blend = m.Fit();
  EXPECT_LT((blend.Blend(m.force, m.force) - m.force).cwiseAbs().maxCoeff(), 1e-12);
}

TEST(ForceBlend, IsBetterThanEither) {
  for (const double size : {0.0, 0.5, 5.0}) {
    const Measured m(size);
    const MatrixX3d error = m.Fit().Blend(m.felt(), m.by_motion()) - m.force;
    EXPECT_LT(Variance(error), 0.9 * Variance(m.felt_noise)) << size;
    EXPECT_LT(Variance(error), 0.5 * Variance(m.motion_noise)) << size;
    EXPECT_LT(SlowVariance(error), 0.3 * SlowVariance(m.felt_noise)) << size;
  }
}

TEST(ForceBlend, WeighsByNoiseAndNotByForce) {
  const MatrixX3d none = Measured(0.0).Fit().felt_weight();
  const MatrixX3d large = Measured(5.0).Fit().felt_weight();
  EXPECT_GT(none.row(0).minCoeff(), 0.7);                     // quick: the accelerometer
  EXPECT_LT(none.row(ForceBlend::kOctaves).maxCoeff(), 0.2);  // slow: the motion
  // The octaves in which there is no force.
  EXPECT_LT((large - none).topRows(3).cwiseAbs().maxCoeff(), 0.1);
}

TEST(ForceBlend, DoesNotReachAcrossGaps) {
  const Measured m(1.0);
  const ForceBlend blend = m.Fit();
  MatrixX3d other = m.felt();
  other.bottomRows(kSamples - kGapAt).array() += 100.0;
  const MatrixX3d one = blend.Blend(m.felt(), m.by_motion());
  const MatrixX3d two = blend.Blend(other, m.by_motion());
  EXPECT_EQ((one - two).topRows(kGapAt).cwiseAbs().maxCoeff(), 0.0);
}

}  // namespace
}  // namespace odmc
