#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <limits>
#include <vector>

#include "odmc/math/descent.h"

namespace odmc {
namespace {

using Eigen::Matrix2d;
using Eigen::Vector2d;
using Eigen::VectorXd;

/// (x − m)ᵀ H (x − m) / 2, with Newton's step to its minimum.
struct Bowl {
  Matrix2d H;
  Vector2d middle;

  double operator()(const VectorXd& x) const { return 0.5 * (x - middle).dot(H * (x - middle)); }
  VectorXd Step(const CostAt& at) const { return -H.inverse() * (H * (at.x - middle)); }
};

const Bowl kBowl = {(Matrix2d() << 3.0, 1.0, 1.0, 2.0).finished(), Vector2d(0.7, -1.2)};

CostAt From(const Bowl& bowl, const Vector2d& x) { return {x, bowl(x)}; }

CostAt DescendBowl(const DescentOptions& options, const Vector2d& x) {
  return Descend(
      From(kBowl, x), options, [](const CostAt& at) { return kBowl.Step(at); }, kBowl);
}

TEST(Descend, ReachesTheMinimumOfAQuadraticInOneStep) {
  DescentOptions options;
  options.most_steps = 1;
  const CostAt end = DescendBowl(options, {5.0, 4.0});
  EXPECT_NEAR((end.x - kBowl.middle).norm(), 0.0, 1e-12);
  EXPECT_EQ(end.cost, kBowl(end.x));
}

TEST(Descend, TakesTheLongestShareThatLowersTheCost) {
  std::vector<double> tried;
  const auto cost = [&tried](const VectorXd& x) {
    tried.push_back(x[0]);
    return std::abs(x[0] - 1.0);
  };
  DescentOptions options;
  options.most_steps = 1;
  options.shorter = 0.4;
  // From 0 the whole step of 10 and its share 0.4 overshoot by more than they began with.
  const CostAt end = Descend(
      {VectorXd::Zero(1), 1.0}, options, [](const CostAt&) { return VectorXd::Constant(1, 10.0); },
      cost);
  EXPECT_EQ(tried.size(), 3u);
  EXPECT_NEAR(end.x[0], 1.6, 1e-12);
  EXPECT_NEAR(end.cost, 0.6, 1e-12);
}

TEST(Descend, StaysWhereNoShareLowersTheCost) {
  int steps = 0, costs = 0;
  const auto uphill = [&steps](const CostAt& at) {
    ++steps;
    return VectorXd(-kBowl.Step(at));
  };
  const auto cost = [&costs](const VectorXd& x) {
    ++costs;
    return kBowl(x);
  };
  DescentOptions options;
  options.shorter = 0.5;
  options.shortest = 0.2;
  const Vector2d start(3.0, 3.0);
  const CostAt end = Descend(From(kBowl, start), options, uphill, cost);
  EXPECT_EQ(end.x, start);
  EXPECT_EQ(end.cost, kBowl(start));
  EXPECT_EQ(steps, 1);
  EXPECT_EQ(costs, 3);  // 1, 0.5 and 0.25 of the step
}

TEST(Descend, StaysWithinItsBounds) {
  DescentOptions options;
  options.least = Vector2d(1.0, -1.0);
  options.most = Vector2d(6.0, 5.0);
  const CostAt end = DescendBowl(options, {5.0, 4.0});
  EXPECT_EQ(end.x, Vector2d(1.0, -1.0));
}

TEST(Descend, LeavesOutPointsWithoutACost) {
  for (const double none :
       {std::numeric_limits<double>::infinity(), std::numeric_limits<double>::quiet_NaN()}) {
    const auto cost = [none](const VectorXd& x) { return x[0] < 2.0 ? none : x[0]; };
    const CostAt end = Descend(
        {VectorXd::Constant(1, 5.0), 5.0}, {},
        [](const CostAt&) { return VectorXd::Constant(1, -4.0); }, cost);
    EXPECT_GE(end.x[0], 2.0);
    EXPECT_LT(end.x[0], 3.0);
  }
}

TEST(Descend, EndsAfterAStepThatGainsLittle) {
  // Newton's method for a root of higher order: each step lowers |x|⁴ to (3/4)⁴ of itself.
  int steps = 0;
  const auto step = [&steps](const CostAt& at) {
    ++steps;
    return VectorXd(-0.25 * at.x);
  };
  const auto cost = [](const VectorXd& x) { return std::pow(x[0], 4); };
  DescentOptions options;
  options.most_steps = 100;
  options.least_gain = 0.1;
  const CostAt end = Descend({VectorXd::Constant(1, 1.0), 1.0}, options, step, cost);
  // Gains 0.684, 0.216, 0.0684: the third is the last.
  EXPECT_EQ(steps, 3);
  EXPECT_NEAR(end.x[0], std::pow(0.75, 3), 1e-12);
}

}  // namespace
}  // namespace odmc
