#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <numeric>

#include "odmc/attribution/close_loop.h"
#include "odmc/attribution/regression.h"
#include "odmc/math/statistics.h"
#include "odmc/sim/gaussian.h"

namespace odmc {
namespace test {
namespace {

constexpr int kSamples = 500;

/// Force x = truth * column + first-order noise; the other channels are white noise.
WrenchRegression Made(double truth, double decay, int num_columns, int seed) {
  Gaussian random(seed, 7);
  WrenchRegression r;
  r.y.resize(kSamples, kNumChannels);
  for (Eigen::MatrixXd& c : r.columns) c.setZero(kSamples, num_columns);
  double noise = 0.0;
  for (int i = 0; i < kSamples; ++i) {
    noise = decay * noise + std::sqrt(1.0 - decay * decay) * random.Next();
    for (int c = 0; c < kNumChannels; ++c) r.y(i, c) = random.Next();
    for (int k = 0; k < num_columns; ++k) {
      r.columns[0](i, k) = std::sin(0.05 * (k + 1) * i + k);
    }
    r.y(i, 0) = noise + (num_columns > 0 ? truth * r.columns[0](i, 0) : 0.0);
    r.next.push_back(i > 0);
    r.block.push_back(i / 60);
    r.used.push_back(r.block.back() % 4 != 2);
  }
  r.prior_offset.setZero(num_columns);
  r.prior_sigma.setConstant(num_columns, 100.0);
  return r;
}

TEST(FitWrench, FindsACoefficientWithinItsSigmaInCorrelatedNoise) {
  int inside = 0;
  for (int seed = 0; seed < 40; ++seed) {
    const WrenchFit fit = FitWrench(Made(0.7, 0.9, 1, seed));
    const double sigma = std::sqrt(fit.covariance(0, 0));
    inside += std::abs(fit.step[0] - 0.7) < 2.0 * sigma ? 1 : 0;
    EXPECT_LT(std::abs(fit.step[0] - 0.7), 5.0 * sigma);
  }
  EXPECT_GE(inside, 34);  // of 40, 38 expected
}

TEST(FitWrench, RealColumnsGainAndIdleOnesLose) {
  double idle = 0.0;
  for (int seed = 0; seed < 20; ++seed) {
    const WrenchRegression none = Made(0.0, 0.9, 0, seed);
    WrenchRegression one = Made(0.0, 0.9, 1, seed);
    one.y = none.y;
    idle += CrossValidatedGain(FitWrench(none), FitWrench(one)).nats;
    WrenchRegression base = Made(4.0, 0.9, 1, seed);
    WrenchRegression without = base;
    for (Eigen::MatrixXd& c : without.columns) c.resize(kSamples, 0);
    without.prior_offset.resize(0);
    without.prior_sigma.resize(0);
    const WrenchFit with_fit = FitWrench(base), without_fit = FitWrench(without);
    EXPECT_GT(CrossValidatedGain(without_fit, with_fit).nats, 8.0);
    EXPECT_LT(with_fit.plain_mean_square[0], without_fit.plain_mean_square[0]);
    EXPECT_NEAR(with_fit.plain_mean_square[3], without_fit.plain_mean_square[3], 1e-9);
    const QuickGain quick(without, without_fit);
    // The quick look has the base's noise, which has swallowed part of the signal; it ranks.
    std::array<Eigen::MatrixXd, kNumChannels> wrong = base.columns;
    for (int i = 0; i < kSamples; ++i) wrong[0](i, 0) = std::sin(0.11 * i);
    EXPECT_GT(quick.Of(base.columns), 3.0 + 2.0 * quick.Of(wrong));
  }
  EXPECT_LT(idle / 20.0, 0.5);
}

// Two effects that do nearly the same cannot be told apart, and the gain's own sigma says so.
TEST(FitWrench, AGainOverARivalIsAsUncertainAsItSays) {
  std::vector<double> of_twin, sigma_of_twin;
  int told_from_stranger = 0;
  constexpr int kSeeds = 60;
  for (int seed = 0; seed < kSeeds; ++seed) {
    const WrenchRegression truth = Made(3.0, 0.5, 1, seed);
    const WrenchFit fit = FitWrench(truth);
    const auto gain_over = [&](double other_share) {
      WrenchRegression rival = truth;
      for (int i = 0; i < kSamples; ++i) rival.columns[0](i, 0) += other_share * std::sin(0.23 * i);
      return CrossValidatedGain(FitWrench(rival), fit);
    };
    const Gain twin = gain_over(0.05), stranger = gain_over(1.0);
    of_twin.push_back(twin.nats);
    sigma_of_twin.push_back(twin.sigma);
    told_from_stranger += stranger.nats > 3.0 * stranger.sigma ? 1 : 0;
  }
  const double mean = std::accumulate(of_twin.begin(), of_twin.end(), 0.0) / kSeeds;
  double square = 0.0;
  for (const double nats : of_twin) square += (nats - mean) * (nats - mean);
  const double spread = std::sqrt(square / (kSeeds - 1.0));
  std::printf("over a twin %.2f +- %.2f nats, says %.2f; told from a stranger %d of %d times\n",
              mean, spread, Median(sigma_of_twin), told_from_stranger, kSeeds);
  EXPECT_LT(mean, 3.0 * spread);
  EXPECT_NEAR(Median(sigma_of_twin) / spread, 1.0, 0.4);
  EXPECT_GE(told_from_stranger, 0.9 * kSeeds);
}

TEST(Alternatives, AreRivalsThatTheChoiceDoesNotBeatByThreeSigma) {
  const WrenchRegression truth = Made(3.0, 0.5, 1, 4);
  const auto tried = [&](const char* name, double other_share, double score) {
    WrenchRegression r = truth;
    for (int i = 0; i < kSamples; ++i) r.columns[0](i, 0) += other_share * std::sin(0.23 * i);
    Tried t;
    t.result.fit = FitWrench(r);
    t.ranked.name = name;
    t.ranked.score = score;
    return t;
  };
  // None is close by score; the last has no case of its own.
  const std::vector<Tried> all = {tried("choice", 0.0, 300.0), tried("twin", 0.05, 200.0),
                                  tried("stranger", 1.0, 200.0), tried("nothing", 0.05, 2.0)};
  EXPECT_EQ(Alternatives(all, CloseLoopOptions()), std::vector<std::string>{"twin"});
}

TEST(FitWrench, HeldOutSamplesTeachNothing) {
  WrenchRegression r = Made(0.7, 0.5, 1, 3);
  const double before = FitWrench(r).step[0];
  for (int i = 0; i < kSamples; ++i) {
    if (!r.used[i]) r.y(i, 0) += 100.0;
  }
  EXPECT_NEAR(FitWrench(r).step[0], before, 1e-12);
}

}  // namespace
}  // namespace test
}  // namespace odmc
