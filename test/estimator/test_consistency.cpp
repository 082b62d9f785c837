#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <cstdio>

#include "odmc/estimator/consistency.h"
#include "odmc/math/statistics.h"
#include "support/jacobian_check.h"

namespace odmc {
namespace test {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr double kDt = 0.01;
constexpr double kInformation = 4.0;  // of one interval

/// Priors so wide that they say nothing.
VectorXd NoPriors(int n) { return VectorXd::Constant(n, 1e9); }

struct Run {
  double inflation = 1.0;  ///< the factor found
  double error = 0.0;      ///< of the estimate, over the sigma of white noise
};

/// Estimates one number from `seconds` of readings with unit AR(1) noise taken for white.
Run Estimate(double rho, double seconds, unsigned seed, double scale_half_way = 1.0) {
  Random random(seed);
  Consistency consistency(1);
  const double root = std::sqrt(kInformation);
  const int n = static_cast<int>(seconds / kDt);
  double noise = random.Normal(), left = 0.0, sum = 0.0;
  for (int i = 0; i < n; ++i) {
    noise = rho * noise + std::sqrt(1.0 - rho * rho) * random.Normal();
    // Reading y = 0 + noise / root; score at the running estimate.
    const double eta = left > 0.0 ? sum / left : 0.0;
    sum += root * noise;
    left += kInformation;
    const VectorXd score = VectorXd::Constant(1, kInformation * eta - root * noise);
    consistency.Add(kDt, score, VectorXd::Constant(1, eta));
    if (consistency.BlockIsFull()) {
      consistency.CloseBlock(MatrixXd::Constant(1, 1, left));
    }
    if (i == n / 2 && scale_half_way != 1.0) {
      consistency.Rescale(MatrixXd::Constant(1, 1, std::sqrt(scale_half_way)));
      left *= scale_half_way;
      sum *= scale_half_way;
    }
  }
  const double eta = sum / left;
  const VectorXd inflation = consistency.Inflation(
      VectorXd::Constant(1, eta), MatrixXd::Constant(1, 1, 1.0 / left), NoPriors(1));
  return {inflation[0], eta * std::sqrt(left)};
}

double MedianInflation(double rho, double seconds, int runs, double* error_rms = nullptr) {
  std::vector<double> factors;
  double sum = 0.0;
  for (int i = 0; i < runs; ++i) {
    const Run run = Estimate(rho, seconds, 100 + static_cast<unsigned>(i));
    factors.push_back(run.inflation);
    sum += run.error * run.error;
  }
  if (error_rms != nullptr) *error_rms = std::sqrt(sum / runs);
  return Median(factors);
}

TEST(Consistency, LeavesWhiteScoresAlmostAlone) {
  for (const double seconds : {10.0, 30.0, 100.0}) {
    const double factor = MedianInflation(0.0, seconds, 100);
    std::printf("white, %.0f s: factor %.2f\n", seconds, factor);
    EXPECT_GE(factor, 1.0);
    EXPECT_LT(factor, 1.25);
  }
}

TEST(Consistency, FindsTheFactorOfCorrelatedScores) {
  const double rho = 0.9, expected = std::sqrt((1.0 + rho) / (1.0 - rho));
  double error_rms = 0.0;
  const double factor = MedianInflation(rho, 60.0, 100, &error_rms);
  std::printf("rho 0.9: factor %.2f, expected %.2f, errors are %.2f sigma\n", factor, expected,
              error_rms);
  EXPECT_NEAR(factor / expected, 1.0, 0.3);
  EXPECT_NEAR(factor / error_rms, 1.0, 0.3);  // what the estimate's errors really are
}

TEST(Consistency, MakesSigmasSmallerOnlyAsFarAsTheErrorsAre) {
  EXPECT_EQ(Consistency(3).Inflation(VectorXd::Zero(3), MatrixXd::Identity(3, 3), NoPriors(3)),
            VectorXd::Ones(3));  // nothing seen: white
  // Readings that swing back: the estimate's error is smaller than white noise would make it.
  const double rho = -0.5, expected = std::sqrt((1.0 + rho) / (1.0 - rho));
  const double factor = MedianInflation(rho, 30.0, 20);
  EXPECT_GT(factor, expected);
  EXPECT_LT(factor, 1.0);
}

TEST(Consistency, KeepsItsMemoryBoundedOverALongFlight) {
  // 640 s: blocks merge five times and still give the same answer.
  const double rho = 0.9, expected = std::sqrt((1.0 + rho) / (1.0 - rho));
  EXPECT_NEAR(MedianInflation(rho, 640.0, 10) / expected, 1.0, 0.3);
}

TEST(Consistency, FollowsAScaleOfThePast) {
  // All readings before half-way count for half: scores and information together.
  std::vector<double> factors;
  for (unsigned i = 0; i < 50; ++i) factors.push_back(Estimate(0.9, 60.0, i, 0.5).inflation);
  EXPECT_GT(Median(factors), 2.2);
  EXPECT_LT(Median(factors), 5.7);
}

// A number that walks, followed by a Kalman filter that takes AR(1) noise for white.
double InflationOfAWalk(double rho, unsigned seed) {
  Random random(seed);
  Consistency consistency(1);
  consistency.SetWalking({0});
  const double step = 1e-3, root = std::sqrt(kInformation);  // of the walk, an interval
  double truth = 0.0, noise = random.Normal(), information = 1e-6, estimate = 0.0, left = 0.0;
  for (int i = 0; i < 6000; ++i) {
    truth += step * random.Normal();
    noise = rho * noise + std::sqrt(1.0 - rho * rho) * random.Normal();
    const double walked = 1.0 / (1.0 / information + step * step);
    consistency.Walked(MatrixXd::Constant(1, 1, left),
                       MatrixXd::Constant(1, 1, left + walked - information));
    left += walked - information + kInformation;
    information = walked + kInformation;
    const double reading = truth + noise / root;
    const double score = kInformation * (estimate - reading);
    estimate -= score / information;
    consistency.Add(kDt, VectorXd::Constant(1, score), VectorXd::Constant(1, estimate));
    if (consistency.BlockIsFull()) consistency.CloseBlock(MatrixXd::Constant(1, 1, left));
  }
  return consistency.Inflation(VectorXd::Constant(1, estimate),
                               MatrixXd::Constant(1, 1, 1.0 / information), NoPriors(1))[0];
}

TEST(Consistency, OfAWalkCountsTheNoiseAndNotTheWalk) {
  std::vector<double> white, correlated;
  for (unsigned i = 0; i < 50; ++i) {
    white.push_back(InflationOfAWalk(0.0, 200 + i));
    correlated.push_back(InflationOfAWalk(0.9, 200 + i));
  }
  EXPECT_GE(Median(white), 1.0);
  EXPECT_LT(Median(white), 1.3);
  const double expected = std::sqrt(1.9 / 0.1);
  EXPECT_NEAR(Median(correlated) / expected, 1.0, 0.3);
}

TEST(Consistency, TreatsEachParameterByItself) {
  Random random(5);
  Consistency consistency(2);
  double noise = 0.0;
  MatrixXd left = MatrixXd::Zero(2, 2);
  for (int i = 0; i < 6000; ++i) {
    noise = 0.9 * noise + std::sqrt(0.19) * random.Normal();
    VectorXd score(2);
    score << noise, random.Normal();
    left += MatrixXd::Identity(2, 2);
    consistency.Add(kDt, score, VectorXd::Zero(2));
    if (consistency.BlockIsFull()) consistency.CloseBlock(left);
  }
  const VectorXd inflation = consistency.Inflation(VectorXd::Zero(2), left.inverse(), NoPriors(2));
  EXPECT_GT(inflation[0], 3.0);
  EXPECT_LT(inflation[1], 1.5);
}

// The flight shows the first number and nothing of the second; noise is half of what it was taken
// for. What is not shown keeps the sigma of its prior.
TEST(Consistency, LeavesThePriorsShareAsItIs) {
  Random random(6);
  Consistency consistency(2);
  const VectorXd prior_sigma = VectorXd::Constant(2, 0.05);
  MatrixXd left = MatrixXd::Zero(2, 2);
  for (int i = 0; i < 6000; ++i) {
    VectorXd score(2);
    score << 0.5 * random.Normal(), 0.0;
    left(0, 0) += 1.0;
    consistency.Add(kDt, score, VectorXd::Zero(2));
    if (consistency.BlockIsFull()) consistency.CloseBlock(left);
  }
  MatrixXd information = left;
  information.diagonal().array() += 1.0 / (0.05 * 0.05);
  const MatrixXd covariance = information.inverse();
  const VectorXd inflation = consistency.Inflation(VectorXd::Zero(2), covariance, prior_sigma);
  // Information 6000 of the flight, 400 of the prior; half of the noise is a quarter of the
  // variance, and some blocks of the kind that was assumed count with it.
  EXPECT_GT(inflation[0], std::sqrt(0.25 * 6000.0 / 6400.0 + 400.0 / 6400.0));
  EXPECT_LT(inflation[0], 0.75);
  EXPECT_NEAR(inflation[1], 1.0, 1e-9);
  EXPECT_NEAR(std::sqrt(covariance(1, 1)) * inflation[1], 0.05, 1e-9);
}

}  // namespace
}  // namespace test
}  // namespace odmc
