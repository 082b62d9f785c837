#include <gtest/gtest.h>

#include <cmath>
#include <numeric>
#include <random>
#include <utility>
#include <vector>

#include "odmc/attribution/serial_noise.h"
#include "odmc/math/savitzky_golay.h"

namespace odmc {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr int kSamples = 1500;  // a minute
constexpr double kStep_s = 0.04;
constexpr int kFlights = 40;

/// White noise through a short filter, and an error that comes and goes over seconds.
VectorXd Noise(unsigned seed, double slow_sigma, double time_constant_s) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  const double decay = std::exp(-kStep_s / time_constant_s);
  VectorXd e(kSamples);
  double quick = 0.0, slow = slow_sigma * normal(random);
  for (Index i = 0; i < kSamples; ++i) {
    quick = 0.5 * quick + normal(random);
    slow = decay * slow + slow_sigma * std::sqrt(1.0 - decay * decay) * normal(random);
    e[i] = quick + slow;
  }
  return e;
}

/// Samples in use: of ten seconds the last two and a half are left out, if asked for.
std::vector<int> Rows(bool with_gaps) {
  std::vector<int> rows;
  int run = 0;
  for (int i = 0; i < kSamples; ++i) {
    run = with_gaps && i % 250 >= 187 ? 0 : run + 1;
    if (run > SerialNoise::kOrder) rows.push_back(i);
  }
  return rows;
}

/// What whitening makes of a constant force, as its size: the mean over a minute is known to one
/// over it.
double SigmasOfMean(const VectorXd& e, const std::vector<int>& rows) {
  const SerialNoise noise = SerialNoise::Fit(e, rows, kStep_s, false, true);
  const VectorXd constant = noise.Whiten(VectorXd::Ones(kSamples), rows);
  return noise.Whiten(e, rows).dot(constant) / constant.norm();
}

/// Root mean square over flights.
double RmsSigmasOfMean(double slow_sigma, double time_constant_s, bool with_gaps) {
  const std::vector<int> rows = Rows(with_gaps);
  double sum = 0.0;
  for (unsigned seed = 1; seed <= kFlights; ++seed) {
    sum += std::pow(SigmasOfMean(Noise(seed, slow_sigma, time_constant_s), rows), 2);
  }
  return std::sqrt(sum / kFlights);
}

TEST(SerialNoise, WhitensQuickAndSlow) {
  for (const bool with_gaps : {false, true}) {
    const std::vector<int> rows = Rows(with_gaps);
    for (unsigned seed = 1; seed <= 5; ++seed) {
      const VectorXd e = Noise(seed, 1.0, 2.0);
      const VectorXd white = SerialNoise::Fit(e, rows, kStep_s, false, true).Whiten(e, rows);
      EXPECT_NEAR(white.squaredNorm() / static_cast<double>(rows.size()), 1.0, 0.02);
      const Index n = white.size();
      for (const Index lag : {1, 5, 25}) {
        const double together = white.head(n - lag).dot(white.tail(n - lag));
        EXPECT_LT(std::abs(together) / static_cast<double>(n), 0.1) << lag;
      }
    }
  }
}

// The root mean square of forty flights lies within 0.7 and 1.3 at 99 %; a minute hardly tells how
// slow an error is. Without the slow factor it is 1.7 and 2.3.
TEST(SerialNoise, KnowsHowWellAConstantIsKnown) {
  for (const bool with_gaps : {false, true}) {
    for (const double time_constant_s : {0.3, 1.0, 3.0, 8.0}) {
      const double rms = RmsSigmasOfMean(0.3, time_constant_s, with_gaps);
      EXPECT_GT(rms, 0.6) << time_constant_s;
      EXPECT_LT(rms, time_constant_s < 5.0 ? 1.3 : 1.6) << time_constant_s;
    }
    EXPECT_NEAR(RmsSigmasOfMean(0.0, 1.0, with_gaps), 1.0, 0.35);
  }
}

/// A torque by a rate with white noise at 100 Hz: the filter's derivative, its means over 40 ms,
/// and beneath it white noise and an error that comes and goes over two seconds.
VectorXd DerivativeNoise(unsigned seed, Index samples, double slow_sigma) {
  constexpr Index kPerMean = 4;
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  const SavitzkyGolay filter(11);
  const Index n = kPerMean * samples + 11;
  MatrixXd rate(1, n);
  std::vector<double> t_s;
  for (Index i = 0; i < n; ++i) {
    rate(0, i) = normal(random);
    t_s.push_back(0.01 * static_cast<double>(i));
  }
  VectorXd e = VectorXd::Zero(samples);
  double slow = slow_sigma * normal(random);
  for (Index i = 0; i < samples; ++i) {
    for (Index k = 0; k < kPerMean; ++k) {
      e[i] += filter.At(t_s, rate, static_cast<int>(5 + kPerMean * i + k)).first[0] / kPerMean;
    }
    slow = 0.98 * slow + slow_sigma * std::sqrt(1.0 - 0.98 * 0.98) * normal(random);
    e[i] += 0.3 * normal(random) + slow;
  }
  return e;
}

/// Of a force that swings slowly: what its size is found to be over its sigma, as root mean square,
/// and its sigma.
struct SizeOfSwing {
  double rms_sigmas = 0.0, sigma = 0.0;
};
SizeOfSwing SwingIn(Index samples, double frequency_Hz, double slow_sigma,
                    bool with_derivative = true) {
  std::vector<int> rows;
  for (int i = SerialNoise::kOrder; i < samples; ++i) rows.push_back(i);
  double square = 0.0, root_information = 0.0;
  for (unsigned seed = 1; seed <= kFlights; ++seed) {
    const VectorXd e = DerivativeNoise(seed, samples, slow_sigma);
    VectorXd swing(samples);
    for (Index i = 0; i < samples; ++i) {
      swing[i] = std::sin(2.0 * M_PI * frequency_Hz * kStep_s * static_cast<double>(i) + seed);
    }
    const SerialNoise noise = SerialNoise::Fit(e, rows, kStep_s, with_derivative, false);
    const VectorXd white = noise.Whiten(swing, rows);
    square += std::pow(noise.Whiten(e, rows).dot(white) / white.norm(), 2);
    root_information += white.norm() / kFlights;
  }
  return {std::sqrt(square / kFlights), 1.0 / root_information};
}

// Noise of a derivative falls to zero with frequency, more steeply than the order 8 alone, resolved
// as finely as the flight allows, has it.
TEST(SerialNoise, KnowsThatADerivativeHasLittleSlowNoise) {
  for (const auto& [samples, most_share] :
       {std::pair<Index, double>{750, 0.65}, std::pair<Index, double>{1500, 0.45}}) {
    // Forty flights lie within 0.7 and 1.3 at 99 %. How small it is at 0.1 Hz no such flight tells.
    const SizeOfSwing slow = SwingIn(samples, 0.1, 0.0), quicker = SwingIn(samples, 0.5, 0.0);
    EXPECT_LT(slow.sigma, most_share * SwingIn(samples, 0.1, 0.0, false).sigma) << samples;
    EXPECT_LT(slow.rms_sigmas, 1.3) << samples;
    EXPECT_GT(quicker.rms_sigmas, 0.6) << samples;
    EXPECT_LT(quicker.rms_sigmas, 1.3) << samples;
    // An error that comes and goes beneath it is seen.
    const SizeOfSwing beneath = SwingIn(samples, 0.1, 0.3);
    EXPECT_GT(beneath.rms_sigmas, 0.6) << samples;
    EXPECT_LT(beneath.rms_sigmas, 1.3) << samples;
    EXPECT_GT(beneath.sigma, 1.1 * slow.sigma) << samples;
  }
}

// A slow error is as uncertain after a gap as it was at the start.
TEST(SerialNoise, KnowsLessAfterAGap) {
  const std::vector<int> rows = Rows(false);
  const SerialNoise noise = SerialNoise::Fit(Noise(1, 1.0, 3.0), rows, kStep_s, false, true);
  std::vector<int> gap(rows.begin(), rows.begin() + 400);
  gap.insert(gap.end(), rows.begin() + 900, rows.begin() + 1300);
  VectorXd knock = VectorXd::Zero(kSamples);
  knock[rows[900]] = 1.0;
  EXPECT_LT(noise.Whiten(knock, gap)[400], noise.Whiten(knock, rows)[900]);
}

}  // namespace
}  // namespace odmc
