#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>

#include "odmc/inspection/lag_regression.h"
#include "odmc/math/gaussian.h"

namespace odmc {
namespace {

constexpr double kSeconds = 20.0, kStep_s = 0.01;
constexpr double kLively_s = 5.7, kLivelyUntil_s = 6.5;  // within one block of a second

/// A flight in which the moving stream is late by `calm_late_s`, but for one lively second in which
/// its stamps are right.
class LagOfOneBlock : public ::testing::TestWithParam<int> {
 protected:
  LagProblem Problem(double calm_late_s) {
    Gaussian random(GetParam(), 7);
    std::vector<double> times;
    for (double t = 0.0; t < kSeconds; t += 0.005) times.push_back(t);
    Eigen::MatrixXd values(1, static_cast<Eigen::Index>(times.size()));
    double slow = 0.0;
    for (size_t k = 0; k < times.size(); ++k) {
      slow += 0.03 * random.Next() - 0.02 * slow;
      values(0, static_cast<Eigen::Index>(k)) = slow + Lively(times[k]);
    }
    moving_ = std::make_unique<SampledSignal>(times, values);
    LagProblem problem;
    problem.first_s = 0.5;
    problem.step_s = problem.width_s = kStep_s;
    const auto n = static_cast<Eigen::Index>((kSeconds - 1.0) / kStep_s);
    problem.y = Eigen::MatrixXd::Zero(n, 1);
    problem.fixed = Eigen::MatrixXd::Ones(n, 1);
    problem.usable.assign(static_cast<size_t>(n), true);
    problem.moving = moving_.get();
    for (Eigen::Index i = 0; i < n; ++i) {
      const double t = problem.first_s + static_cast<double>(i) * kStep_s;
      const double at = IsLively(t) ? t : t + calm_late_s;
      problem.y(i, 0) =
          moving_->Mean(at - 0.5 * kStep_s, at + 0.5 * kStep_s)[0] + 0.3 * random.Next();
    }
    return problem;
  }

  static bool IsLively(double t_s) { return t_s > kLively_s && t_s < kLivelyUntil_s; }

 private:
  static double Lively(double t_s) {
    return IsLively(t_s) ? 3.0 * std::sin(3.1416 * (t_s - kLively_s) / 0.8) * std::sin(25.0 * t_s)
                         : 0.0;
  }

  std::unique_ptr<SampledSignal> moving_;
};

TEST_P(LagOfOneBlock, IsFoundWhereAllAgree) {
  const auto lag = EstimateLag(Problem(0.0));
  ASSERT_TRUE(lag);
  EXPECT_LT(std::abs(lag->lag_s), std::min(0.004, 3.0 * lag->scatter_s));
  EXPECT_LT(lag->scatter_s, 0.005);
}

// The slopes of the likelihood about its best lag do not show what the others would say alone.
TEST_P(LagOfOneBlock, IsNoSurerThanWhatTheOthersShow) {
  LagProblem problem = Problem(0.04);
  const auto all = EstimateLag(problem);
  for (size_t i = 0; i < problem.usable.size(); ++i) {
    const double t = problem.first_s + static_cast<double>(i) * kStep_s;
    if (t > kLively_s - 0.2 && t < kLivelyUntil_s + 0.2) problem.usable[i] = false;
  }
  const auto others = EstimateLag(problem);
  ASSERT_TRUE(all && others);
  EXPECT_GT(std::abs(others->lag_s - all->lag_s), 0.02);
  EXPECT_LT(std::abs(others->lag_s - all->lag_s), 3.0 * all->scatter_s);
}

INSTANTIATE_TEST_SUITE_P(Draws, LagOfOneBlock, ::testing::Range(1, 7));

}  // namespace
}  // namespace odmc
