#include <gtest/gtest.h>

#include <cmath>

#include "odmc/attribution/spectrum.h"
#include "odmc/math/gaussian.h"

namespace odmc {
namespace test {
namespace {

constexpr double kRate_Hz = 25.0, kHighest_Hz = 7.0;
constexpr int kSamples = 600;

std::vector<double> White(int seed) {
  Gaussian random(seed, 1);
  std::vector<double> run;
  for (int i = 0; i < kSamples; ++i) run.push_back(random.Next());
  return run;
}

TEST(Whiteness, CallsWhiteAndDifferencedNoiseUnstructured) {
  int small = 0;
  for (int seed = 0; seed < 40; ++seed) {
    std::vector<double> run = White(seed);
    if (seed % 2 == 1) {  // as the derivative of a measured velocity
      for (int i = kSamples - 1; i > 0; --i) run[i] -= run[i - 1];
    }
    const WhitenessResult w = TestWhiteness({run}, kRate_Hz, kHighest_Hz);
    small += w.p < 0.01 ? 1 : 0;
    EXPECT_GT(w.p, 1e-4) << "seed " << seed;
  }
  EXPECT_LE(small, 3);
}

TEST(Whiteness, FindsSlowStructureAndItsShare) {
  std::vector<double> run = White(3);
  Gaussian random(4, 2);
  double slow = 0.0;
  for (int i = 0; i < kSamples; ++i) {  // correlation time 2 s, standard deviation 1
    const double decay = std::exp(-0.04 / 2.0);
    slow = decay * slow + std::sqrt(1.0 - decay * decay) * random.Next();
    run[i] += slow;
  }
  const WhitenessResult w = TestWhiteness({run}, kRate_Hz, kHighest_Hz);
  EXPECT_LT(w.p, 1e-8);
  EXPECT_GT(w.structured_share, 0.25);
  EXPECT_LT(w.peak_Hz, 1.0);
}

TEST(Whiteness, FindsALine) {
  std::vector<double> run = White(5);
  for (int i = 0; i < kSamples; ++i) run[i] += 0.8 * std::sin(2.0 * 3.14159265 * 2.0 * 0.04 * i);
  const WhitenessResult w = TestWhiteness({run}, kRate_Hz, kHighest_Hz);
  EXPECT_LT(w.p, 1e-8);
  EXPECT_NEAR(w.peak_Hz, 2.0, 0.1);
  EXPECT_GT(w.structured_share, 0.1);
}

/// Standard deviation 1, correlation time 0.1 s: as of lines between samples.
std::vector<double> BetweenSamples(int seed) {
  Gaussian random(seed, 3);
  const double decay = std::exp(-0.04 / 0.1);
  std::vector<double> run;
  double value = 0.0;
  for (int i = 0; i < kSamples; ++i) {
    value = decay * value + std::sqrt(1.0 - decay * decay) * random.Next();
    run.push_back(value);
  }
  return run;
}

TEST(Whiteness, WhatSlowStreamsLeaveOutIsNoStructure) {
  for (int seed = 0; seed < 20; ++seed) {
    const std::vector<double> change = BetweenSamples(seed), error = BetweenSamples(100 + seed);
    const auto test = [&](double size, const std::vector<std::vector<double>>& by_sampling) {
      std::vector<double> run = White(seed);
      for (int i = 0; i < kSamples; ++i) run[i] = 0.3 * run[i] + size * error[i];
      return TestWhiteness({run}, kRate_Hz, kHighest_Hz, by_sampling);
    };
    EXPECT_LT(test(1.5, {}).p, 1e-8) << "else there is no need";
    const WhitenessResult sampled = test(1.5, {change});
    EXPECT_GT(sampled.p, 1e-4) << "seed " << seed;
    EXPECT_GT(sampled.sampling_share, 0.5) << "seed " << seed;
    // More than streams can leave out is structure.
    EXPECT_LT(test(5.0, {change}).p, 1e-8) << "seed " << seed;
    EXPECT_LT(test(1.5, {std::vector<double>(kSamples, 0.0)}).p, 1e-8) << "nothing changes";
  }
}

TEST(Whiteness, LooksAtNothingTooShort) {
  EXPECT_EQ(TestWhiteness({std::vector<double>(20, 1.0)}, kRate_Hz, kHighest_Hz).p, 1.0);
  EXPECT_EQ(TestWhiteness({}, kRate_Hz, kHighest_Hz).structured_share, 0.0);
}

TEST(Autocorrelation, OfACosineIsACosine) {
  std::vector<double> run;
  for (int i = 0; i < 5000; ++i) run.push_back(std::cos(0.2 * i));
  const std::vector<double> a = Autocorrelation({run}, 20);
  for (int lag = 0; lag < 20; ++lag) EXPECT_NEAR(a[lag], std::cos(0.2 * lag), 0.01);
}

}  // namespace
}  // namespace test
}  // namespace odmc
