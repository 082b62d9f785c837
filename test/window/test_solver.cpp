#include <gtest/gtest.h>

#include <cmath>

#include "odmc/window/window_solver.h"
#include "support/linear_window.h"

namespace odmc {
namespace test {
namespace {

using Eigen::VectorXd;

class CeresWindowSolverTest : public testing::Test {
 protected:
  CeresWindowSolverTest()
      : model_(FourParameterModel()), layout_(model_, model_.InitialValues()), window_(&layout_) {}

  void Fill(int keyframes_per_bias = 0) {
    LinearWindowOptions options;
    options.keyframes_per_bias = keyframes_per_bias;
    options.keyframes = 8;
    LinearWindowMaker(&window_, options, 3).Fill();
    window_.eta() += Random(4).NextVector(layout_.num_estimated(), 0.5);
  }

  /// Gauss-Newton step of the whole window with the parameters' priors, states first.
  VectorXd Step() const {
    Normal normal = DenseNormal(window_);
    const int n = layout_.num_estimated();
    const VectorXd weight = window_.parameter_sigma().cwiseAbs2().cwiseInverse();
    normal.H.bottomRightCorner(n, n) += weight.asDiagonal();
    normal.g.tail(n) += weight.cwiseProduct(window_.eta() - window_.parameter_centre());
    return -normal.H.ldlt().solve(normal.g);
  }

  SolverOptions Options(int iterations) const {
    SolverOptions options;
    options.max_iterations = iterations;
    options.max_time_s = 10.0;
    options.function_tolerance = 1e-16;
    return options;
  }

  DynamicModel model_;
  ParameterLayout layout_;
  Window window_;
};

TEST_F(CeresWindowSolverTest, ReachesTheOptimumOfALinearWindowInOneStep) {
  for (const int per_bias : {0, 3}) {
    window_ = Window(&layout_);
    Fill(per_bias);
    const double before = Step().norm();
    ASSERT_GT(before, 0.1);
    const SolveReport report = CeresWindowSolver().Solve(&window_, Options(1));
    EXPECT_TRUE(report.usable) << report.message;
    EXPECT_LT(report.final_cost, report.initial_cost);
    EXPECT_LT(Step().norm(), 1e-4 * before);  // the trust region's damping is all that is left
    CeresWindowSolver().Solve(&window_, Options(5));
    EXPECT_LT(Step().norm(), 1e-8 * before);
  }
}

TEST_F(CeresWindowSolverTest, KeepsQuaternionsUnit) {
  Fill();
  for (Keyframe& k : window_.keyframes()) {
    const Eigen::Quaterniond q = Exp(Eigen::Vector3d(0.3, -0.2, 0.5));
    std::copy(q.coeffs().data(), q.coeffs().data() + 4, k.x.begin() + 3);
  }
  EXPECT_TRUE(CeresWindowSolver().Solve(&window_, Options(10)).usable);
  for (const Keyframe& k : window_.keyframes()) {
    const Eigen::Map<const Eigen::Vector4d> q(k.x.data() + 3);
    EXPECT_NEAR(q.norm(), 1.0, 1e-12);
    EXPECT_LT(q.head<3>().norm(), 1e-6);  // its prior is the identity
  }
}

TEST_F(CeresWindowSolverTest, UsesThePriorOfWhatLeft) {
  Fill();
  Prior& prior = window_.prior();
  const int n = layout_.num_estimated();
  prior.has_state = true;
  prior.A = Random(6).NextMatrix(12 + n, 12 + n);
  prior.b = Random(7).NextVector(12 + n);
  prior.A.middleCols(3, 3).setZero();  // keeps the window linear
  prior.eta_lin = window_.eta();
  window_.keyframes().front().in_prior = true;
  EXPECT_TRUE(CeresWindowSolver().Solve(&window_, Options(5)).usable);
  EXPECT_LT(Step().norm(), 1e-8);
}

TEST_F(CeresWindowSolverTest, RefusesAStateThatIsNotANumber) {
  Fill();
  window_.keyframes()[2].x[1] = std::nan("");
  const ParameterVector eta = window_.eta();
  const auto x = window_.keyframes()[4].x;
  const SolveReport report = CeresWindowSolver().Solve(&window_, Options(3));
  EXPECT_FALSE(report.usable);
  EXPECT_FALSE(report.message.empty());
  EXPECT_EQ(window_.eta(), eta);
  EXPECT_EQ(window_.keyframes()[4].x, x);
}

TEST_F(CeresWindowSolverTest, RefusesParametersThatAreNotNumbers) {
  Fill();
  window_.eta()[1] = std::nan("");
  EXPECT_FALSE(CeresWindowSolver().Solve(&window_, Options(3)).usable);
}

TEST_F(CeresWindowSolverTest, StopsAtItsIterationBound) {
  Fill();
  const SolveReport report = CeresWindowSolver().Solve(&window_, Options(1));
  EXPECT_LE(report.iterations, 2);  // Ceres counts the start
}

}  // namespace
}  // namespace test
}  // namespace odmc
