#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

#include "odmc/math/statistics.h"
#include "support/jacobian_check.h"

namespace odmc {
namespace test {
namespace {

TEST(Statistics, MedianOfAnOddSampleIsItsMiddle) { EXPECT_EQ(Median({5.0, -1.0, 3.0}), 3.0); }

TEST(Statistics, MedianOfAnEvenSampleIsTheMeanOfTheMiddleTwo) {
  EXPECT_EQ(Median({4.0, 1.0, 2.0, 100.0}), 3.0);
}

TEST(Statistics, TheMiddleOccursInTheSample) {
  EXPECT_EQ(MiddleOf(std::vector<double>{5.0, -1.0, 3.0}), 3.0);
  EXPECT_EQ(MiddleOf(std::vector<double>{4.0, 1.0, 2.0, 100.0}), 4.0);
  EXPECT_EQ(MiddleOf(std::vector<long>{7}), 7);
}

TEST(Statistics, EmptySamplesGiveZero) {
  EXPECT_EQ(Median({}), 0.0);
  EXPECT_EQ(Quantile({}, 0.9), 0.0);
  EXPECT_EQ(RobustSigma({}), 0.0);
}

TEST(Statistics, QuantilesInterpolateAndReachTheEnds) {
  const std::vector<double> sample = {30.0, 10.0, 20.0, 40.0, 50.0};
  EXPECT_EQ(Quantile(sample, 0.0), 10.0);
  EXPECT_EQ(Quantile(sample, 1.0), 50.0);
  EXPECT_DOUBLE_EQ(Quantile(sample, 0.25), 20.0);
  EXPECT_DOUBLE_EQ(Quantile(sample, 0.95), 48.0);
  EXPECT_EQ(Quantile({7.0}, 0.3), 7.0);
}

TEST(Statistics, RobustSigmaIsThatOfAGaussian) {
  Random random(9);
  std::vector<double> sample(20000);
  for (double& x : sample) x = 0.3 * random.Normal();
  EXPECT_NEAR(RobustSigma(sample), 0.3, 0.01);
}

TEST(Statistics, RobustSigmaInPlaceIsTheSame) {
  std::vector<double> sample = {3.0, -1.0, 0.5, -2.0};
  const double expected = RobustSigma(sample);
  EXPECT_EQ(RobustSigmaInPlace(&sample), expected);
  std::sort(sample.begin(), sample.end());
  EXPECT_EQ(sample, (std::vector<double>{0.5, 1.0, 2.0, 3.0}));  // the magnitudes
}

TEST(Statistics, RobustSigmaIgnoresATenthOfOutliers) {
  Random random(9);
  std::vector<double> sample(20000);
  for (size_t i = 0; i < sample.size(); ++i)
    sample[i] = (i % 10 == 0 ? 1e6 : 0.3) * random.Normal();
  EXPECT_NEAR(RobustSigma(sample), 0.3, 0.06);
}

TEST(Statistics, HuberSigmaIsThatOfAGaussian) {
  Random random(9);
  std::vector<double> sample(20000);
  for (double& x : sample) x = 0.3 * random.Normal();
  EXPECT_NEAR(HuberSigma(sample), 0.3, 0.01);
  EXPECT_EQ(HuberSigma({}), 0.0);
  EXPECT_EQ(HuberSigma({0.0, 0.0, 0.0}), 0.0);
}

// Each counts as one of two sigma: 0.9 E[min(z^2/s^2, 4)] + 0.1 * 4 = E[min(z^2, 4)].
TEST(Statistics, HuberSigmaGrowsByAThirdWithATenthOfOutliers) {
  Random random(9);
  std::vector<double> sample(20000);
  for (size_t i = 0; i < sample.size(); ++i)
    sample[i] = (i % 10 == 0 ? 1e6 : 0.3) * random.Normal();
  EXPECT_NEAR(HuberSigma(sample), 1.304 * 0.3, 0.01);
}

TEST(Statistics, HuberSigmaOfReadingsInStepsIsNoWholeStep) {
  for (const double step : {0.1, 0.5, 1.0, 1.5, 2.0}) {
    Random random(9);
    std::vector<double> sample(20000);
    for (double& x : sample) x = step * std::round(random.Normal() / step);
    EXPECT_NEAR(HuberSigma(sample), std::sqrt(1.0 + step * step / 12.0), 0.1) << step;
  }
}

TEST(Statistics, LogNormalDeviationIsThatOfExponentials) {
  Random random(9);
  double sum = 0.0, square = 0.0;
  constexpr int kDraws = 200000;
  for (int i = 0; i < kDraws; ++i) {
    const double x = std::exp(0.5 * random.Normal());
    sum += x;
    square += x * x;
  }
  const double mean = sum / kDraws;
  EXPECT_NEAR(LogNormalDeviation(0.5), std::sqrt(square / kDraws - mean * mean), 0.01);
  EXPECT_NEAR(LogNormalDeviation(1e-3), 1e-3, 1e-8);
}

}  // namespace
}  // namespace test
}  // namespace odmc
