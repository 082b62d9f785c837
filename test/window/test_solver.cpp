#include <ceres/loss_function.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <string>

#include "odmc/window/ceres_window_solver.h"
#include "odmc/window/chain_alignment.h"
#include "odmc/window/chain_prior.h"
#include "odmc/window/marginalization.h"
#include "support/linear_window.h"

namespace odmc {
namespace test {
namespace {

using Eigen::VectorXd;

/// Every solver keeps the same promises.
class WindowSolverTest : public testing::TestWithParam<const char*> {
 protected:
  WindowSolverTest()
      : model_(FourParameterModel()), layout_(model_, model_.InitialValues()), window_(&layout_) {}

  void Fill(int keyframes_per_bias = 0) {
    LinearWindowOptions options;
    options.keyframes_per_bias = keyframes_per_bias;
    options.keyframes = 8;
    LinearWindowMaker(&window_, options, 3).Fill();
    window_.eta() += Random(4).NextVector(layout_.num_estimated(), 0.5);
  }

  SolveReport Solve(const SolverOptions& options) { return Solve(GetParam(), options, &window_); }

  static SolveReport Solve(const std::string& solver, const SolverOptions& options,
                           Window* window) {
    if (solver == "ceres") return CeresWindowSolver().Solve(window, options);
    return SolveAlongChain(options, window);
  }

  static SolveReport SolveAlongChain(const SolverOptions& options, Window* window) {
    const IncrementalOptions incremental;
    const LinearisationError error(&incremental);
    Chain chain(&incremental);
    ChainPast past;
    ChainSolution solution(&incremental, &chain, &error);
    ReadChain(*window, &chain, &past);
    solution.Reset(*window, past.rows().stride());
    return ChainAlignment(&chain, &solution).Solve(past.rows(), options, window);
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

TEST_P(WindowSolverTest, ReachesTheOptimumOfALinearWindowInOneStep) {
  for (const int per_bias : {0, 3}) {
    window_ = Window(&layout_);
    Fill(per_bias);
    const double before = Step().norm();
    ASSERT_GT(before, 0.1);
    const SolveReport report = Solve(Options(1));
    EXPECT_TRUE(report.usable) << report.message;
    EXPECT_LT(report.final_cost, report.initial_cost);
    EXPECT_LT(Step().norm(), 1e-4 * before);  // the trust region's damping is all that is left
    Solve(Options(5));
    EXPECT_LT(Step().norm(), 1e-8 * before);
  }
}

TEST_P(WindowSolverTest, KeepsQuaternionsUnit) {
  Fill();
  for (Keyframe& k : window_.keyframes()) {
    const Eigen::Quaterniond q = Exp(Eigen::Vector3d(0.3, -0.2, 0.5));
    std::copy(q.coeffs().data(), q.coeffs().data() + 4, k.x.begin() + 3);
  }
  EXPECT_TRUE(Solve(Options(10)).usable);
  for (const Keyframe& k : window_.keyframes()) {
    const Eigen::Map<const Eigen::Vector4d> q(k.x.data() + 3);
    EXPECT_NEAR(q.norm(), 1.0, 1e-12);
    EXPECT_LT(q.head<3>().norm(), 1e-6);  // its prior is the identity
  }
}

TEST_P(WindowSolverTest, UsesThePriorOfWhatLeft) {
  Fill();
  Prior& prior = window_.prior();
  const int n = layout_.num_estimated();
  prior.has_state = true;
  prior.A = Random(6).NextMatrix(12 + n, 12 + n);
  prior.b = Random(7).NextVector(12 + n);
  prior.A.middleCols(3, 3).setZero();  // keeps the window linear
  prior.eta_lin = window_.eta();
  window_.keyframes().front().in_prior = true;
  EXPECT_TRUE(Solve(Options(5)).usable);
  EXPECT_LT(Step().norm(), 1e-8);
}

TEST_P(WindowSolverTest, RefusesAStateThatIsNotANumber) {
  Fill();
  window_.keyframes()[2].x[1] = std::nan("");
  const ParameterVector eta = window_.eta();
  const auto x = window_.keyframes()[4].x;
  const SolveReport report = Solve(Options(3));
  EXPECT_FALSE(report.usable);
  EXPECT_FALSE(report.message.empty());
  EXPECT_EQ(window_.eta(), eta);
  EXPECT_EQ(window_.keyframes()[4].x, x);
}

TEST_P(WindowSolverTest, RefusesParametersThatAreNotNumbers) {
  Fill();
  window_.eta()[1] = std::nan("");
  EXPECT_FALSE(Solve(Options(3)).usable);
}

TEST_P(WindowSolverTest, StopsAtItsIterationBound) {
  Fill();
  const SolveReport report = Solve(Options(1));
  EXPECT_LE(report.iterations, 2);  // the start counts as one
}

INSTANTIATE_TEST_SUITE_P(All, WindowSolverTest, testing::Values("chain", "ceres"),
                         [](const auto& name) { return std::string(name.param); });

/// Windows with all that changes how they are eliminated.
struct Shape {
  int per_bias, unlinked, marginalized;
};

class SolversTest : public WindowSolverTest {
 protected:
  static std::string Name(const Shape& s) {
    return std::to_string(s.per_bias) + " keyframes a bias, chain broken at " +
           std::to_string(s.unlinked) + ", " + std::to_string(s.marginalized) + " left";
  }

  /// The same window twice: cost functions are not copied, so it is made anew.
  void Make(const Shape& shape, Window* window) const {
    LinearWindowOptions options;
    options.keyframes = 12;
    options.keyframes_per_bias = shape.per_bias;
    options.unlinked = shape.unlinked;
    LinearWindowMaker(window, options, 11).Fill();
    Random random(21);
    const auto turn = [&](double size) {  // rotations: what is not linear in here
      for (Keyframe& k : window->keyframes()) {
        const Eigen::Quaterniond q = State::FromBlock(k.x.data()).q_WS * Exp(size * random.Next3());
        std::copy(q.coeffs().data(), q.coeffs().data() + 4, k.x.begin() + 3);
      }
    };
    turn(0.4);
    const VectorXd often = VectorXd::Constant(layout_.num_estimated(), 0.1);
    for (int i = 0; i < shape.marginalized; ++i) MarginalizeOldest(window, often);
    // The prior knows the rotation, too, and the oldest state leaves its linearization point.
    Prior& prior = window->prior();
    if (prior.has_state) {
      prior.A.middleCols<3>(kTangentRotation) =
          random.NextMatrix(static_cast<int>(prior.b.size()), 3);
    }
    turn(0.2);
    for (Keyframe& k : window->keyframes()) k.x[0] += 0.3;
    window->eta() += random.NextVector(layout_.num_estimated(), 0.5);
  }
};

TEST_F(SolversTest, TakeTheSameStepsOnEveryShapeOfWindow) {
  for (const Shape& shape : {Shape{0, -1, 0}, Shape{0, 5, 0}, Shape{3, -1, 0}, Shape{3, 6, 0},
                             Shape{1, -1, 0}, Shape{0, -1, 4}, Shape{3, 7, 4}, Shape{5, -1, 5}}) {
    for (const int iterations : {1, 2, 6}) {
      Window ours(&layout_), reference(&layout_);
      Make(shape, &ours);
      Make(shape, &reference);
      const SolveReport a = Solve("chain", Options(iterations), &ours);
      const SolveReport b = Solve("ceres", Options(iterations), &reference);
      ASSERT_TRUE(a.usable && b.usable) << Name(shape);
      // Near the optimum one may stop a step of 1e-8 before the other.
      const double same = iterations > 2 ? 1e-7 : 1e-9;
      EXPECT_TRUE(a.improved);
      EXPECT_NEAR(a.initial_cost, b.initial_cost, 1e-9 * b.initial_cost) << Name(shape);
      EXPECT_NEAR(a.final_cost, b.final_cost, 1e-9 * b.initial_cost) << Name(shape);
      EXPECT_LT((ours.eta() - reference.eta()).norm(), same * reference.eta().norm())
          << Name(shape) << ", " << iterations << " iterations";
      for (size_t i = 0; i < ours.keyframes().size(); ++i) {
        for (int j = 0; j < kStateSize; ++j) {
          EXPECT_NEAR(ours.keyframes()[i].x[j], reference.keyframes()[i].x[j], 10.0 * same)
              << Name(shape) << ", keyframe " << i << ", entry " << j;
        }
      }
      for (size_t i = 0; i < ours.biases().size(); ++i) {
        for (int j = 0; j < 6; ++j) {
          EXPECT_NEAR(ours.biases()[i].x[j], reference.biases()[i].x[j], 10.0 * same)
              << Name(shape);
        }
      }
    }
  }
}

/// r = [100 (y - x^2), 20 (1 - x)] of the first two parameters: the step from far out raises the
/// cost.
class Rosenbrock final : public ceres::CostFunction {
 public:
  explicit Rosenbrock(int n) {
    set_num_residuals(2);
    *mutable_parameter_block_sizes() = {kStateSize, n};
  }
  bool Evaluate(double const* const* blocks, double* r, double** jacobians) const override {
    const double x = blocks[1][0], y = blocks[1][1];
    r[0] = 100.0 * (y - x * x);
    r[1] = 20.0 * (1.0 - x);
    if (jacobians == nullptr) return true;
    const int n = parameter_block_sizes()[1];
    if (jacobians[0] != nullptr) std::fill_n(jacobians[0], 2 * kStateSize, 0.0);
    if (jacobians[1] != nullptr) {
      std::fill_n(jacobians[1], 2 * n, 0.0);
      jacobians[1][0] = -200.0 * x;
      jacobians[1][1] = 100.0;
      jacobians[1][n] = -20.0;
    }
    return true;
  }
};

TEST_F(SolversTest, RefuseAndAcceptTheSameStepsOfACurvedValley) {
  const ceres::HuberLoss loss(2.0);
  const auto make = [&](Window* window) {
    LinearWindowOptions options;
    options.keyframes = 3;
    LinearWindowMaker(window, options, 5).Fill();
    Factor factor;
    factor.kind = FactorKind::kOther;
    factor.cost = std::make_unique<Rosenbrock>(layout_.num_estimated());
    factor.loss = &loss;
    factor.state0 = window->keyframes().front().id;
    factor.parameters = true;
    window->AddFactor(std::move(factor));
    window->eta()[0] = -1.2;
    window->eta()[1] = 1.0;
  };
  int refused = 0;
  for (int iterations = 1; iterations <= 12; ++iterations) {
    Window ours(&layout_), reference(&layout_);
    make(&ours);
    make(&reference);
    const SolveReport a = Solve("chain", Options(iterations), &ours);
    const SolveReport b = Solve("ceres", Options(iterations), &reference);
    EXPECT_EQ(a.improved, b.improved) << iterations;
    EXPECT_NEAR(a.final_cost, b.final_cost, 1e-7 * b.initial_cost) << iterations;
    EXPECT_LT((ours.eta() - reference.eta()).norm(), 1e-6) << iterations << " iterations";
    refused += a.improved ? 0 : 1;
  }
  EXPECT_GT(refused, 0);  // else the valley does not test what it is for
}

}  // namespace
}  // namespace test
}  // namespace odmc
