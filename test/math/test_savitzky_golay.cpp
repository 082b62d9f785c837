#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "odmc/math/savitzky_golay.h"
#include "support/jacobian_check.h"

namespace odmc {
namespace test {
namespace {

std::vector<double> EvenTimes(int n, double step, double start = 0.0) {
  std::vector<double> times(n);
  for (int i = 0; i < n; ++i) times[i] = start + step * i;
  return times;
}

/// Response to a unit sample at `at`: one coefficient of the filter.
LocalPolynomial Response(const SavitzkyGolay& filter, const std::vector<double>& times, int at) {
  Eigen::MatrixXd samples = Eigen::MatrixXd::Zero(1, static_cast<int>(times.size()));
  samples(0, at) = 1.0;
  return filter.At(times, samples, filter.count() / 2);
}

void ExpectExactOnCubic(const std::vector<double>& times, int count) {
  const int n = static_cast<int>(times.size());
  Eigen::MatrixXd samples(2, n);
  const double t0 = times.front();
  for (int i = 0; i < n; ++i) {
    const double t = times[i] - t0;
    samples.col(i) << 1.0 - 2.0 * t + 3.0 * t * t - 40.0 * t * t * t, 5.0 * t * t * t;
  }
  const SavitzkyGolay filter(count);
  for (int i = count / 2; i < n - count / 2; ++i) {
    const double t = times[i] - t0;
    const LocalPolynomial fit = filter.At(times, samples, i);
    EXPECT_NEAR(fit.value[0], samples(0, i), 1e-11);
    EXPECT_NEAR(fit.first[0], -2.0 + 6.0 * t - 120.0 * t * t, 1e-9);
    EXPECT_NEAR(fit.second[0], 6.0 - 240.0 * t, 1e-6);
    EXPECT_NEAR(fit.first[1], 15.0 * t * t, 1e-9);
    EXPECT_NEAR(fit.second[1], 30.0 * t, 1e-6);
  }
}

TEST(SavitzkyGolay, IsExactOnCubics) { ExpectExactOnCubic(EvenTimes(40, 0.01), 11); }

TEST(SavitzkyGolay, IsExactOnCubicsWithJitteredStamps) {
  Random random(3);
  std::vector<double> times = EvenTimes(60, 0.01, 1.7e9 * 1e-3);
  for (double& t : times) t += random.Next(0.004);
  ExpectExactOnCubic(times, 11);
}

TEST(SavitzkyGolay, HasTheTextbookCoefficientsOnEvenSpacing) {
  // Savitzky and Golay 1964, cubic, 5 and 7 points: smoothing, first and second derivative.
  const std::vector<double> smooth5 = {-3, 12, 17, 12, -3}, first5 = {1, -8, 0, 8, -1},
                            second5 = {2, -1, -2, -1, 2};
  const std::vector<double> smooth7 = {-2, 3, 6, 7, 6, 3, -2},
                            first7 = {22, -67, -58, 0, 58, 67, -22};
  const double step = 0.0025;
  for (int i = 0; i < 5; ++i) {
    const LocalPolynomial r = Response(SavitzkyGolay(5), EvenTimes(5, step), i);
    EXPECT_NEAR(r.value[0], smooth5[i] / 35.0, 1e-12);
    EXPECT_NEAR(r.first[0] * step, first5[i] / 12.0, 1e-12);
    EXPECT_NEAR(r.second[0] * step * step, second5[i] / 7.0, 1e-12);
  }
  for (int i = 0; i < 7; ++i) {
    const LocalPolynomial r = Response(SavitzkyGolay(7), EvenTimes(7, step), i);
    EXPECT_NEAR(r.value[0], smooth7[i] / 21.0, 1e-12);
    EXPECT_NEAR(r.first[0] * step, first7[i] / 252.0, 1e-12);
  }
}

TEST(SavitzkyGolay, CoefficientsOfTheValueAddUpToOneAndOfTheDerivativeToZero) {
  const std::vector<double> times = EvenTimes(41, 0.0025);
  const SavitzkyGolay filter(41);
  double value = 0.0, first = 0.0, second = 0.0;
  for (int i = 0; i < 41; ++i) {
    const LocalPolynomial r = Response(filter, times, i);
    value += r.value[0];
    first += r.first[0];
    second += r.second[0];
  }
  EXPECT_NEAR(value, 1.0, 1e-12);
  EXPECT_NEAR(first, 0.0, 1e-9);
  EXPECT_NEAR(second, 0.0, 1e-6);
}

TEST(SavitzkyGolay, TakesTheOddCountNearestToTheWidth) {
  EXPECT_EQ(SavitzkyGolay::NearestOddCount(0.1, 0.01), 11);    // 10: as near to 9, the longer wins
  EXPECT_EQ(SavitzkyGolay::NearestOddCount(0.1, 0.0025), 41);  // 40
  EXPECT_EQ(SavitzkyGolay::NearestOddCount(0.1, 0.1 / 9.2), 9);
  EXPECT_EQ(SavitzkyGolay::NearestOddCount(0.1, 0.1 / 10.8), 11);
  EXPECT_EQ(SavitzkyGolay::NearestOddCount(0.1, 1.0), 5);
}

}  // namespace
}  // namespace test
}  // namespace odmc
