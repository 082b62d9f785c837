#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <limits>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "odmc/window/ceres_window_solver.h"
#include "odmc/window/incremental_window_solver.h"
#include "support/linear_window.h"

namespace odmc {
namespace test {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

/// Everything in every update, so that a linear window is solved exactly.
IncrementalOptions Exact() {
  IncrementalOptions options;
  options.wildfire = 0.0;
  options.back_substituted_keyframes = 1000;
  options.largest_step = std::numeric_limits<double>::infinity();
  return options;
}

SolverOptions Thorough() {
  SolverOptions options;
  options.max_iterations = 20;
  options.max_time_s = 10.0;
  options.function_tolerance = 1e-18;
  return options;
}

/// What a sliding window may look like.
struct Shape {
  int per_bias, unlinked;
  bool anchored;
};

std::string NameOf(const Shape& s) {
  return std::string(s.anchored ? "Anchored" : "Plain") + "PerBias" + std::to_string(s.per_bias) +
         (s.unlinked < 0 ? "" : "BrokenAt" + std::to_string(s.unlinked));
}

/// The same linear window twice: one slides under the incremental solver, one under Ceres.
class IncrementalSolver : public testing::Test {
 protected:
  explicit IncrementalSolver(const IncrementalOptions& options = Exact())
      : model_(FourParameterModel()),
        layout_(model_, model_.InitialValues()),
        ours_(&layout_),
        reference_(&layout_),
        solver_(options) {}

  void Start(const Shape& shape, unsigned seed) {
    LinearWindowOptions options;
    options.keyframes_per_bias = shape.per_bias;
    options.unlinked = shape.unlinked;
    options.anchored = shape.anchored;
    our_maker_ = std::make_unique<LinearWindowMaker>(&ours_, options, seed);
    reference_maker_ = std::make_unique<LinearWindowMaker>(&reference_, options, seed);
  }

  void AddKeyframe() {
    our_maker_->AddKeyframe();
    reference_maker_->AddKeyframe();
  }

  void DropOldest() {
    ASSERT_TRUE(solver_.MarginalizeOldest(&ours_, sigma_, nullptr));
    ASSERT_TRUE(ceres_.MarginalizeOldest(&reference_, sigma_, nullptr));
  }

  void SolveBoth() {
    our_report_ = solver_.Solve(&ours_, SolverOptions());
    ASSERT_TRUE(our_report_.usable) << our_report_.message;
    EXPECT_FALSE(our_report_.aligned);
    SolveReference();
  }

  void SolveReference() {
    ASSERT_TRUE(ceres_.Solve(&reference_, Thorough()).usable);
    // Ceres stops at steps of 1e-8; a few undamped ones more. The anchor follows the solution.
    for (int i = 0; i < (reference_.anchor_entry() >= 0 ? 40 : 2); ++i) {
      reference_.MoveAnchor();
      Polish(&reference_);
    }
  }

  /// One Gauss-Newton step of the whole window, dense.
  void Polish(Window* window) const {
    Normal normal = DenseNormal(*window);
    const int n = layout_.num_estimated();
    const VectorXd weight = window->parameter_sigma().cwiseAbs2().cwiseInverse();
    normal.H.bottomRightCorner(n, n) += weight.asDiagonal();
    normal.g.tail(n) += weight.cwiseProduct(window->eta() - window->parameter_centre());
    const VectorXd step = -normal.H.ldlt().solve(normal.g);
    int at = 0;
    for (Keyframe& k : window->keyframes()) {
      const auto from = k.x;
      StateManifold().Plus(from.data(), step.data() + at, k.x.data());
      at += 12;
    }
    for (Bias& b : window->biases()) {
      for (size_t j = 0; j < 6; ++j) b.x[j] += step[at++];
    }
    window->eta() += step.tail(n);
  }

  /// Largest relative difference of parameters, states and biases.
  double Difference() const {
    double largest = (ours_.eta() - reference_.eta()).cwiseAbs().maxCoeff() /
                     std::max(1.0, reference_.eta().cwiseAbs().maxCoeff());
    const auto compare = [&largest](double a, double b) {
      largest = std::max(largest, std::abs(a - b) / std::max(1.0, std::abs(b)));
    };
    EXPECT_EQ(ours_.keyframes().size(), reference_.keyframes().size());
    for (size_t i = 0; i < ours_.keyframes().size(); ++i) {
      for (size_t j = 0; j < kStateSize; ++j) {
        compare(ours_.keyframes()[i].x[j], reference_.keyframes()[i].x[j]);
      }
    }
    EXPECT_EQ(ours_.biases().size(), reference_.biases().size());
    for (size_t i = 0; i < ours_.biases().size(); ++i) {
      for (size_t j = 0; j < 6; ++j) compare(ours_.biases()[i].x[j], reference_.biases()[i].x[j]);
    }
    return largest;
  }

  /// Largest relative difference of the covariances of parameters and newest state.
  double CovarianceDifference() {
    MatrixXd a, b;
    EXPECT_TRUE(solver_.ParameterCovariance(ours_, sigma_, &a));
    EXPECT_TRUE(ceres_.ParameterCovariance(reference_, VectorXd::Zero(sigma_.size()), &b));
    double difference = (a - b).norm() / b.norm();
    WindowSolver::StateMatrix state_a, state_b;
    EXPECT_TRUE(solver_.StateCovariance(ours_, &state_a));
    EXPECT_TRUE(ceres_.StateCovariance(reference_, &state_b));
    return std::max(difference, (state_a - state_b).norm() / state_b.norm());
  }

  DynamicModel model_;
  ParameterLayout layout_;
  Window ours_, reference_;
  IncrementalWindowSolver solver_;
  CeresWindowSolver ceres_{1000};
  VectorXd sigma_ = VectorXd::Constant(layout_.num_estimated(), 1e9);  // priors keep their points
  std::unique_ptr<LinearWindowMaker> our_maker_, reference_maker_;
  SolveReport our_report_;
};

class SlidingWindow : public IncrementalSolver, public testing::WithParamInterface<Shape> {};

TEST_P(SlidingWindow, EqualsTheFullSolveAtEveryUpdate) {
  Start(GetParam(), 31);
  for (int k = 0; k < 40; ++k) {
    AddKeyframe();
    SolveBoth();
    // What left keeps following the anchor here, and does not in a prior.
    if (!GetParam().anchored || k <= 12) {
      EXPECT_LT(Difference(), 1e-9) << "keyframe " << k;
      EXPECT_LT(CovarianceDifference(), 1e-8) << "keyframe " << k;  // Ceres' squares the condition
    }
    if (k >= 12) DropOldest();
  }
}

TEST_P(SlidingWindow, KeepsWhatLeftWhenTheWindowIsEmptied) {
  Start(GetParam(), 32);
  for (int k = 0; k < 30; ++k) {
    AddKeyframe();
    SolveBoth();
    if (ours_.keyframes().size() > 8) DropOldest();
    if (k != 19) continue;
    while (!ours_.keyframes().empty()) DropOldest();
    ours_.biases().clear();
    reference_.biases().clear();
    const MatrixXd a = solver_.PastInformation(ours_), b = ceres_.PastInformation(reference_);
    EXPECT_LT((a - b).norm(), 1e-9 * b.norm());
    Start(GetParam(), 33);  // a new chain
  }
  if (GetParam().anchored) return;  // see above
  EXPECT_LT(Difference(), 1e-9);
  EXPECT_LT(CovarianceDifference(), 1e-8);
}

TEST_P(SlidingWindow, HandsOverToABatchSolveAndTakesOverAgain) {
  Start(GetParam(), 34);
  for (int k = 0; k < 30; ++k) {
    AddKeyframe();
    if (k % 7 == 6) {
      SolverOptions align = Thorough();
      align.align = true;
      const SolveReport report = solver_.Solve(&ours_, align);
      ASSERT_TRUE(report.usable);
      EXPECT_TRUE(report.aligned);
      SolveReference();
      EXPECT_LT(CovarianceDifference(), 1e-6) << "keyframe " << k;  // by the chain it built
    } else {
      SolveBoth();
      if (GetParam().anchored && k > 10) continue;
      EXPECT_LT(Difference(), 1e-8) << "keyframe " << k;  // the batch stops at its own tolerance
    }
    if (k >= 10) DropOldest();
  }
}

TEST_P(SlidingWindow, ScalesThePastAsTheBatchSolverDoes) {
  Start(GetParam(), 35);
  const VectorXd scale = (VectorXd(4) << 0.5, 2.0, 0.1, 1.3).finished();
  for (int k = 0; k < 30; ++k) {
    AddKeyframe();
    SolveBoth();
    if (k >= 10) DropOldest();
    if (k % 5 != 4 || k < 12) continue;
    const MatrixXd a = solver_.ScalePast(scale, &ours_);
    const MatrixXd b = ceres_.ScalePast(scale, &reference_);
    // Directions of much the same information are any directions of their plane.
    EXPECT_LT((a - b).norm(), 1e-6 * b.norm());
    SolveBoth();
    if (!GetParam().anchored) {
      EXPECT_LT(Difference(), 1e-7) << "keyframe " << k;
    }
    EXPECT_LT(CovarianceDifference(), 1e-6) << "keyframe " << k;
  }
}

TEST_P(SlidingWindow, LetsThePastWalkAsTheBatchSolverDoes) {
  Start(GetParam(), 36);
  const VectorXd direction = (VectorXd(4) << 1.0, 0.0, 0.7, 0.0).finished();
  for (int k = 0; k < 30; ++k) {
    AddKeyframe();
    SolveBoth();
    if (k >= 10) DropOldest();
    if (k % 3 != 2 || k < 12) continue;
    MatrixXd before, after;
    ASSERT_TRUE(solver_.ParameterCovariance(ours_, sigma_, &before));
    solver_.LetPastWalk(direction, 0.01, &ours_);
    ceres_.LetPastWalk(direction, 0.01, &reference_);
    ASSERT_TRUE(solver_.ParameterCovariance(ours_, sigma_, &after));
    EXPECT_GT(after(2, 2), 1.0001 * before(2, 2));
    SolveBoth();
    if (!GetParam().anchored) {
      EXPECT_LT(Difference(), 1e-7) << "keyframe " << k;
    }
    EXPECT_LT(CovarianceDifference(), 1e-6) << "keyframe " << k;
  }
}

INSTANTIATE_TEST_SUITE_P(Shapes, SlidingWindow,
                         testing::Values(Shape{0, -1, false}, Shape{0, 5, false},
                                         Shape{3, -1, false}, Shape{1, -1, false},
                                         Shape{5, 17, false}, Shape{0, -1, true},
                                         Shape{4, 9, true}),
                         [](const auto& named) { return NameOf(named.param); });

TEST_F(IncrementalSolver, LettingThePastVaryIsTheBatchSolversStep) {
  Start({0, -1, false}, 41);
  for (int k = 0; k < 20; ++k) {
    AddKeyframe();
    SolveBoth();
    if (k >= 6) DropOldest();
  }
  MatrixXd before, after;
  ASSERT_TRUE(solver_.ParameterCovariance(ours_, sigma_, &before));
  const ProcessStep step = {0.9, 0.3};
  solver_.LetPastVary(2, step, &ours_);
  ceres_.LetPastVary(2, step, &reference_);
  ASSERT_TRUE(solver_.ParameterCovariance(ours_, sigma_, &after));
  EXPECT_GT(after(2, 2), 1.001 * before(2, 2));
  for (int k = 0; k < 5; ++k) {
    SolveBoth();
    EXPECT_LT(CovarianceDifference(), 1e-6) << "keyframe " << k;
    EXPECT_LT(Difference(), 1e-6) << "keyframe " << k;
    AddKeyframe();
    DropOldest();
  }
}

TEST_F(IncrementalSolver, WrittenPriorLeavesACeresSolveNothingToDo) {
  Start({3, -1, true}, 42);
  for (int k = 0; k < 25; ++k) {
    AddKeyframe();
    SolveBoth();
    if (k >= 9) DropOldest();
  }
  SolveBoth();
  const VectorXd eta = ours_.eta();
  solver_.WritePrior(&ours_);
  ASSERT_TRUE(CeresWindowSolver().Solve(&ours_, Thorough()).usable);
  EXPECT_LT((ours_.eta() - eta).norm(), 1e-8 * eta.norm());
}

/// A state's parts as they enter LinearCost; a factor of all four parameters on one keyframe.
Factor OwnFactor(std::int64_t id, double shift, int n) {
  Random random(77);
  Factor factor;
  factor.kind = FactorKind::kOther;
  MatrixXd of_state = random.NextMatrix(6, 12);
  of_state.middleCols<3>(3).setZero();
  factor.cost =
      std::make_unique<LinearCost>(random.NextVector(6) + VectorXd::Constant(6, shift),
                                   std::vector<MatrixXd>{of_state, random.NextMatrix(6, n)}, 1);
  factor.state0 = id;
  factor.parameters = true;
  return factor;
}

TEST_F(IncrementalSolver, NewWeightsOfWindowAndPastTakeEffectTogether) {
  Start({0, -1, false}, 47);
  const int n = layout_.num_estimated();
  for (int k = 0; k < 40; ++k) {
    AddKeyframe();
    if (k % 4 == 3) {
      ours_.AddFactor(OwnFactor(k, 0.0, n));
      reference_.AddFactor(OwnFactor(k, 0.0, n));
    }
    SolveBoth();
    if (k >= 30) DropOldest();
  }
  int weighed = 0;
  const auto weigh = [&weighed](Keyframe* keyframe) {
    for (Factor& f : keyframe->factors) {
      if (!f.parameters || f.state1 >= 0) continue;
      f.cost = OwnFactor(keyframe->id, 3.0, 4).cost;
      ++f.revision;
      ++weighed;
    }
  };
  const VectorXd before = reference_.eta();
  const VectorXd scale = (VectorXd(4) << 0.5, 2.0, 0.1, 1.3).finished();
  SolverOptions hasty;
  hasty.max_time_s = 1e-9;  // 30 keyframes, 12 an update
  solver_.Reweigh(scale, weigh, &ours_);
  int updates = 0;
  while (true) {
    our_report_ = solver_.Solve(&ours_, hasty);
    ASSERT_TRUE(our_report_.usable);
    if (!our_report_.reweighing) break;
    ASSERT_LT(++updates, 12);
    EXPECT_LT((ours_.eta() - before).norm(), 1e-8 * before.norm());  // as if nothing had changed
  }
  EXPECT_GE(updates, 2);
  const int of_ours = std::exchange(weighed, 0);
  EXPECT_GT(of_ours, 5);
  ceres_.Reweigh(scale, weigh, &reference_);
  EXPECT_EQ(weighed, of_ours);
  const MatrixXd a = solver_.PastInformation(ours_), b = ceres_.PastInformation(reference_);
  EXPECT_LT((a - b).norm(), 1e-6 * b.norm());
  SolveBoth();
  EXPECT_GT((ours_.eta() - before).norm(), 1e-2 * before.norm());
  EXPECT_LT(Difference(), 1e-7);
  EXPECT_LT(CovarianceDifference(), 1e-6);
  // Where a keyframe leaves on the way, the rest is weighed at once.
  const auto back = [](Keyframe* keyframe) {
    for (Factor& f : keyframe->factors) {
      if (!f.parameters || f.state1 >= 0) continue;
      f.cost = OwnFactor(keyframe->id, 1.0, 4).cost;
      ++f.revision;
    }
  };
  solver_.Reweigh(scale.cwiseInverse(), back, &ours_);
  ceres_.Reweigh(scale.cwiseInverse(), back, &reference_);
  DropOldest();
  SolveBoth();
  EXPECT_FALSE(our_report_.reweighing);
  EXPECT_LT(Difference(), 1e-6);
}

TEST(RootTriangle, GradientsMoveWhatIsHardlyKnownByNoMoreThanAllowed) {
  const BorderColumns columns(2);
  RootTriangle free(2);
  std::vector<double> rows(static_cast<size_t>(2 * free.stride()), 0.0);
  rows[BorderColumns::kParameters] = 100.0;
  rows[static_cast<size_t>(free.stride()) + BorderColumns::kParameters + 1] = 1e-3;
  free.Absorb(rows.data(), free.stride(), 2);
  RootTriangle bounded = free;
  std::vector<double> gradient(static_cast<size_t>(columns.pivots()), 0.0), x(rows.size());
  gradient[BorderColumns::kParameters] = gradient[BorderColumns::kParameters + 1] = 1.0;
  free.AddGradient(gradient);
  bounded.AddGradient(gradient, 1.0);
  free.Solve(-1, 0.0, x.data());
  EXPECT_NEAR(x[BorderColumns::kParameters], -1e-4, 1e-12);
  EXPECT_NEAR(x[BorderColumns::kParameters + 1], -1e6, 1e-2);
  bounded.Solve(-1, 0.0, x.data());
  EXPECT_NEAR(x[BorderColumns::kParameters], -1e-4, 1e-12);
  EXPECT_NEAR(x[BorderColumns::kParameters + 1], -1e3, 1e-5);  // one sigma
}

TEST_F(IncrementalSolver, TouchedFactorsOfOldKeyframesComeInAsFastAsTimeAllows) {
  Start({0, -1, false}, 43);
  const int n = layout_.num_estimated();
  for (int k = 0; k < 30; ++k) {
    AddKeyframe();
    if (k == 2 || k == 3 || k == 28) {
      ours_.AddFactor(OwnFactor(k, 0.0, n));
      reference_.AddFactor(OwnFactor(k, 0.0, n));
    }
    SolveBoth();
  }
  const auto replace = [&](std::int64_t id) {
    for (Window* window : {&ours_, &reference_}) {
      for (Factor& f : window->keyframe(id).factors) {
        if (f.parameters && f.state1 < 0) {
          f.cost = OwnFactor(id, 3.0, n).cost;
          window->Touch(&f);
        }
      }
    }
  };
  // A recent one at once, an old one after the sweep.
  replace(28);
  SolveBoth();
  EXPECT_GT(our_report_.eliminated, 0);
  EXPECT_LT(Difference(), 1e-9);
  replace(2);
  SolverOptions hasty;
  hasty.max_time_s = 1e-9;  // 30 keyframes, 6 to 24 an update
  int updates = 0;
  do {
    our_report_ = solver_.Solve(&ours_, hasty);
    ASSERT_TRUE(our_report_.usable);
    ASSERT_LT(++updates, 12);
  } while (our_report_.sweeping);
  EXPECT_GT(updates, 1);
  SolveReference();
  EXPECT_LT(Difference(), 1e-9);
  replace(3);  // with time enough at once
  SolveBoth();
  EXPECT_LT(CovarianceDifference(), 1e-8);
}

TEST_F(IncrementalSolver, ChangesOnlyWhatANewKeyframeTouches) {
  Start({0, -1, false}, 44);
  for (int k = 0; k < 60; ++k) {
    AddKeyframe();
    solver_.Solve(&ours_, SolverOptions());
  }
  for (int k = 0; k < 20; ++k) {
    AddKeyframe();
    const SolveReport report = solver_.Solve(&ours_, SolverOptions());
    // The new one, a sweep's share and its last step, the recent ones twice.
    EXPECT_LE(report.eliminated, 1 + 6 + 4 + 2 * 4);
  }
}

TEST_F(IncrementalSolver, RefusesAFactorThatIsNotANumberAndKeepsThePast) {
  Start({0, -1, false}, 45);
  for (int k = 0; k < 20; ++k) {
    AddKeyframe();
    SolveBoth();
    if (k >= 6) DropOldest();
  }
  const MatrixXd past = solver_.PastInformation(ours_);
  our_maker_->AddKeyframe();
  ours_.keyframes().back().x[1] = std::nan("");
  const VectorXd eta = ours_.eta();
  const SolveReport report = solver_.Solve(&ours_, SolverOptions());
  EXPECT_FALSE(report.usable);
  EXPECT_FALSE(report.message.empty());
  EXPECT_EQ(VectorXd(ours_.eta()), eta);
  EXPECT_LT((solver_.PastInformation(ours_) - past).norm(), 1e-8 * past.norm());
  // Repaired, it goes on.
  ours_.keyframes().back().x[1] = 0.0;
  reference_maker_->AddKeyframe();
  SolveBoth();
  EXPECT_LT(Difference(), 1e-8);
}

TEST_F(IncrementalSolver, LeavesStepsBeyondALinearModelToTheBatchSolve) {
  IncrementalOptions options = Exact();
  options.largest_step = 1e-6;
  IncrementalWindowSolver careful(options);
  Start({0, -1, false}, 46);
  for (int k = 0; k < 5; ++k) AddKeyframe();
  const SolveReport report = careful.Solve(&ours_, Thorough());
  EXPECT_TRUE(report.usable);
  EXPECT_TRUE(report.aligned);
  SolveReference();
  EXPECT_LT(Difference(), 1e-7);
}

TEST_F(IncrementalSolver, DampsStepsBeyondALinearModelWhereTheBatchSolveDoesNotFit) {
  IncrementalOptions options = Exact();
  options.largest_step = 0.01;
  options.sweep_keyframes = 2;
  options.recent_keyframes = 1;
  options.recent_passes = 0;
  IncrementalWindowSolver careful(options);
  Start({0, -1, false}, 47);
  for (int k = 0; k < 2; ++k) AddKeyframe();
  SolverOptions hasty = Thorough();
  hasty.max_iterations = 1;
  ASSERT_TRUE(careful.Solve(&ours_, hasty).usable);
  for (int k = 0; k < 28; ++k) AddKeyframe();
  hasty.max_work = 20;  // of 30 keyframes
  const VectorXd most = options.largest_step * ours_.parameter_sigma();
  SolveReport report;
  int updates = 0, long_ones = 0;
  do {
    const VectorXd before = ours_.eta();
    report = careful.Solve(&ours_, hasty);
    ASSERT_TRUE(report.usable);
    EXPECT_FALSE(report.aligned);
    const double step = (ours_.eta() - before).cwiseAbs().cwiseQuotient(most).maxCoeff();
    EXPECT_LE(step, 2.0 + 1e-9);  // from one side of the point of linearization to the other
    long_ones += step > 0.5 ? 1 : 0;
    ASSERT_LT(++updates, 2000);
  } while (report.sweeping);
  EXPECT_GT(long_ones, 5);
  SolveReference();
  EXPECT_LT(Difference(), 1e-7);
}

/// Robust factors of parameters, and old fronts that are corrected, not eliminated anew.
class RobustWindow : public IncrementalSolver {
 protected:
  explicit RobustWindow(int corrected_keyframes)
      : RobustWindow(OnlyCorrections(corrected_keyframes)) {}
  explicit RobustWindow(const IncrementalOptions& options) : IncrementalSolver(options) {}

  static IncrementalOptions OnlyCorrections(int corrected_keyframes) {
    IncrementalOptions options = Exact();
    const double never = std::numeric_limits<double>::infinity();
    options.relinearise_parameters = options.relinearise_share = never;
    options.relinearise_state.fill(never);
    options.segment_keyframes = corrected_keyframes;
    options.sweep_share = 0.0;
    options.sweep_keyframes = 3;
    options.relinearise_recent = options.same_point = 0.0;
    return options;
  }

  void AddRobustKeyframe() {
    AddKeyframe();
    for (Window* window : {&ours_, &reference_}) {
      for (Keyframe& keyframe : window->keyframes()) {
        for (Factor& factor : keyframe.factors) {
          if (factor.parameters) factor.loss = &loss_;
        }
      }
    }
  }

  /// @returns keyframes eliminated
  int SolveWithoutHurry() {
    SolverOptions hasty;
    hasty.max_time_s = 1e-9;
    const SolveReport report = solver_.Solve(&ours_, hasty);
    EXPECT_TRUE(report.usable);
    return report.eliminated;
  }

  int Converge(int updates = 200) {
    int eliminated = 0;
    for (int i = 0; i < updates; ++i) eliminated += SolveWithoutHurry();
    return eliminated;
  }

  void ConvergeReference() {
    SolveReference();
    for (int i = 0; i < 100; ++i) Polish(&reference_);
  }

  ceres::HuberLoss loss_{0.8};
};

class Corrected : public RobustWindow, public testing::WithParamInterface<Shape> {
 protected:
  Corrected() : RobustWindow(1000) {}
};

TEST_P(Corrected, OldFrontsFollowTheTrueResiduals) {
  Start(GetParam(), 48);
  for (int k = 0; k < 20; ++k) {
    AddRobustKeyframe();
    ASSERT_TRUE(solver_.Solve(&ours_, SolverOptions()).usable);
  }
  Converge();
  const VectorXd before = ours_.eta();
  for (int k = 0; k < 6; ++k) {
    AddRobustKeyframe();
    SolveWithoutHurry();
  }
  EXPECT_LE(Converge(200), 200 * 3 * 3);  // the recent ones at most three times, no old one
  EXPECT_GT((ours_.eta() - before).norm(), 1e-3);  // there was something to correct
  ConvergeReference();
  EXPECT_LT(Difference(), 1e-6);

  // What corrections found leaves with the keyframes: their gradient at the optimum stays.
  const VectorXd eta = ours_.eta();
  for (int i = 0; i < 12; ++i) ASSERT_TRUE(solver_.MarginalizeOldest(&ours_, sigma_, nullptr));
  Converge();
  EXPECT_LT((ours_.eta() - eta).norm(), 1e-6 * eta.norm());
  for (Factor& f : ours_.keyframes().front().factors) ours_.Touch(&f);  // sweep from the past
  SolverOptions patient;
  patient.max_time_s = 10.0;
  EXPECT_GT(solver_.Solve(&ours_, patient).eliminated, 10);
  Converge();
  EXPECT_LT((ours_.eta() - eta).norm(), 1e-6 * eta.norm());
}

INSTANTIATE_TEST_SUITE_P(Shapes, Corrected,
                         testing::Values(Shape{0, -1, false}, Shape{0, 17, false},
                                         Shape{4, -1, false}, Shape{5, 13, false}),
                         [](const auto& named) { return NameOf(named.param); });

/// r of another cost and a constant.
class ShiftedCost final : public ceres::CostFunction {
 public:
  ShiftedCost(std::unique_ptr<ceres::CostFunction> cost, double shift)
      : cost_(std::move(cost)), shift_(shift) {
    set_num_residuals(cost_->num_residuals());
    *mutable_parameter_block_sizes() = cost_->parameter_block_sizes();
  }
  bool Evaluate(double const* const* blocks, double* residual, double** jacobians) const override {
    if (!cost_->Evaluate(blocks, residual, jacobians)) return false;
    for (int i = 0; i < num_residuals(); ++i) residual[i] += shift_;
    return true;
  }

 private:
  std::unique_ptr<ceres::CostFunction> cost_;
  double shift_;
};

/// Nothing but the robust weights of recent keyframes is followed.
class RecentWeights : public RobustWindow {
 protected:
  RecentWeights() : RobustWindow(Options()) {}
  static IncrementalOptions Options() {
    IncrementalOptions options = OnlyCorrections(1000);
    options.corrected_segments = 0;
    options.relinearise_recent = std::numeric_limits<double>::infinity();
    return options;
  }
};

TEST_F(RecentWeights, AreFollowed) {
  Start({0, -1, false}, 52);
  for (int k = 0; k < 12; ++k) {
    AddKeyframe();
    ASSERT_TRUE(solver_.Solve(&ours_, SolverOptions()).usable);
  }
  for (Window* window : {&ours_, &reference_}) {
    for (const std::int64_t id : {9, 10}) {  // with the next states, all of them recent
      for (Factor& factor : window->keyframe(id).factors) {
        if (!factor.parameters) continue;
        factor.cost = std::make_unique<ShiftedCost>(std::move(factor.cost), 3.0);
        factor.loss = &loss_;
        window->Touch(&factor);
      }
    }
  }
  Converge(50);
  ConvergeReference();
  MatrixXd covariance;
  ASSERT_TRUE(solver_.ParameterCovariance(ours_, sigma_, &covariance));
  const VectorXd sigma = covariance.diagonal().cwiseSqrt();
  const double off = (ours_.eta() - reference_.eta()).cwiseQuotient(sigma).cwiseAbs().maxCoeff();
  std::printf("%.3f sigma off\n", off);
  EXPECT_LT(off, 0.03);
}

class CorrectedTwins : public RobustWindow {
 protected:
  CorrectedTwins() : RobustWindow(1000) {}

  /// Right-hand side of what the past says of the parameters, zero at parameters zero.
  VectorXd PastAfterLeaving(IncrementalWindowSolver* solver, Window* window) {
    SolverOptions hasty;
    hasty.max_time_s = 1e-9;       // no sweep
    for (int i = 0; i < 2; ++i) {  // parameters move with the new keyframe, then they are looked at
      EXPECT_TRUE(solver->Solve(window, hasty).usable);
    }
    // What a factor with the next state says of parameters alone, that one's own factors show.
    for (int i = 0; i < 2; ++i) EXPECT_TRUE(solver->MarginalizeOldest(window, sigma_, nullptr));
    solver->WritePrior(window);
    const Prior& prior = window->prior();
    const Eigen::Index n = layout_.num_estimated();
    return (prior.b - prior.A.rightCols(n) * prior.eta_lin).tail(n);
  }

  IncrementalWindowSolver twin_{OnlyCorrections(1000)};
};

TEST_F(CorrectedTwins, WhatCorrectionsFoundMovesThePastByASigmaAtMost) {
  Start({0, -1, false}, 53);
  for (int k = 0; k < 10; ++k) {
    AddKeyframe();
    ASSERT_TRUE(solver_.Solve(&ours_, SolverOptions()).usable);
    ASSERT_TRUE(twin_.Solve(&reference_, SolverOptions()).usable);
  }
  for (Factor& factor : ours_.keyframes().front().factors) {
    if (factor.parameters) {
      factor.cost = std::make_unique<ShiftedCost>(std::move(factor.cost), 1e3);
    }
  }
  const VectorXd moved = PastAfterLeaving(&solver_, &ours_) - PastAfterLeaving(&twin_, &reference_);
  EXPECT_LT(moved.cwiseAbs().maxCoeff(), 1.0 + 1e-9);
  EXPECT_GT(moved.cwiseAbs().maxCoeff(), 0.99);
}

/// r of another cost, and ±bend |eta|²: its Jacobian turns with the parameters.
class CurvedCost final : public ceres::CostFunction {
 public:
  CurvedCost(std::unique_ptr<ceres::CostFunction> linear, size_t parameters, double bend)
      : linear_(std::move(linear)), parameters_(parameters), bend_(bend) {
    set_num_residuals(linear_->num_residuals());
    *mutable_parameter_block_sizes() = linear_->parameter_block_sizes();
  }

  bool Evaluate(double const* const* blocks, double* residual, double** jacobians) const override {
    if (!linear_->Evaluate(blocks, residual, jacobians)) return false;
    const int n = parameter_block_sizes()[parameters_];
    const Eigen::Map<const VectorXd> eta(blocks[parameters_], n);
    for (int i = 0; i < num_residuals(); ++i) {
      const double bend = i % 2 == 0 ? bend_ : -bend_;
      residual[i] += bend * eta.squaredNorm();
      if (jacobians == nullptr || jacobians[parameters_] == nullptr) continue;
      for (int j = 0; j < n; ++j) jacobians[parameters_][i * n + j] += 2.0 * bend * eta[j];
    }
    return true;
  }

 private:
  std::unique_ptr<ceres::CostFunction> linear_;
  size_t parameters_;
  double bend_;
};

/// Factors whose Jacobians by the parameters turn, in old fronts that are corrected only.
class CurvedWindow : public RobustWindow, public testing::WithParamInterface<Shape> {
 protected:
  explicit CurvedWindow(int corrected_keyframes = 1000) : RobustWindow(corrected_keyframes) {}

  void AddCurvedKeyframe() {
    AddKeyframe();
    for (Window* window : {&ours_, &reference_}) {
      for (Keyframe& keyframe : window->keyframes()) {
        for (Factor& factor : keyframe.factors) {
          if (!factor.parameters || dynamic_cast<CurvedCost*>(factor.cost.get()) != nullptr) {
            continue;
          }
          const size_t parameters = factor.cost->parameter_block_sizes().size() - 1;
          factor.cost = std::make_unique<CurvedCost>(std::move(factor.cost), parameters, 0.1);
        }
      }
    }
  }
};

TEST_P(CurvedWindow, StepsFollowTheJacobiansOfThePresent) {
  Start(GetParam(), 50);
  for (int k = 0; k < 16; ++k) {
    AddCurvedKeyframe();
    ASSERT_TRUE(solver_.Solve(&ours_, SolverOptions()).usable);
  }
  Converge();
  const VectorXd before = ours_.eta();
  for (int k = 0; k < 8; ++k) {
    AddCurvedKeyframe();
    SolveWithoutHurry();
  }
  EXPECT_LE(Converge(200), 200 * 2 * 3);  // the recent ones twice, no old one
  EXPECT_GT((ours_.eta() - before).norm(), 1e-2);
  ConvergeReference();
  EXPECT_LT(Difference(), 1e-6);
}

INSTANTIATE_TEST_SUITE_P(Shapes, CurvedWindow,
                         testing::Values(Shape{0, -1, false}, Shape{4, -1, false}),
                         [](const auto& named) { return NameOf(named.param); });

/// More segments than may wait for their turn.
class CurvedLongWindow : public CurvedWindow {
 protected:
  CurvedLongWindow() : CurvedWindow(2) {}

  void SolveInTime() {
    SolverOptions patient;
    patient.max_time_s = 10.0;
    ASSERT_TRUE(solver_.Solve(&ours_, patient).usable);
    MatrixXd covariance;
    ASSERT_TRUE(solver_.ParameterCovariance(ours_, sigma_, &covariance));
    sigma_of_eta_ = covariance.diagonal().cwiseSqrt();
  }

  /// What the newest keyframe says of the parameters lies far off.
  void Surprise() {
    for (Factor& factor : ours_.keyframe(ours_.keyframes().back().id - 1).factors) {
      if (!factor.parameters) continue;
      factor.cost = std::make_unique<ShiftedCost>(std::move(factor.cost), 5.0);
    }
  }

  VectorXd sigma_of_eta_;
};

TEST_P(CurvedLongWindow, IsCorrectedInOneUpdateWhereParametersMove) {
  Start(GetParam(), 54);
  for (int k = 0; k < 30; ++k) {
    AddCurvedKeyframe();
    SolveInTime();
  }
  Converge();
  double moved = 0.0, left = 0.0;
  for (int k = 0; k < 6; ++k) {
    const VectorXd before = ours_.eta();
    AddCurvedKeyframe();
    Surprise();
    SolveInTime();
    const VectorXd after = ours_.eta();
    Converge();
    moved = std::max(moved, (after - before).cwiseQuotient(sigma_of_eta_).cwiseAbs().maxCoeff());
    left = std::max(left, (after - ours_.eta()).cwiseQuotient(sigma_of_eta_).cwiseAbs().maxCoeff());
  }
  std::printf("moved by %.3f sigma, %.4f left\n", moved, left);
  EXPECT_GT(moved, 0.3);
  EXPECT_LT(left, 0.1);
}

INSTANTIATE_TEST_SUITE_P(Shapes, CurvedLongWindow,
                         testing::Values(Shape{0, -1, false}, Shape{4, -1, false}),
                         [](const auto& named) { return NameOf(named.param); });

/// A pass of corrections in portions, while sweeps and recent keyframes are eliminated under it.
class CorrectedInPortions : public RobustWindow, public testing::WithParamInterface<int> {
 protected:
  CorrectedInPortions() : RobustWindow(GetParam()) { Start({4, -1, false}, 49); }

  void TouchParametersOf(std::int64_t id) {
    for (Factor& f : ours_.keyframe(id).factors) {
      if (f.parameters) ours_.Touch(&f);
    }
  }

  void ExpectReference() {
    Converge(200 * (24 / GetParam() + 2));
    ConvergeReference();
    EXPECT_LT(Difference(), 1e-6);
  }
};

TEST_P(CorrectedInPortions, WhileRecentKeyframesAreEliminatedAnew) {
  for (int k = 0; k < 24; ++k) {
    AddRobustKeyframe();
    if (k <= 14) solver_.Solve(&ours_, SolverOptions());
    if (k > 14) TouchParametersOf(k - 4);  // the oldest recent one, where a pass may stand
    SolveWithoutHurry();
  }
  ExpectReference();
}

TEST_P(CorrectedInPortions, WhileASweepGoesOn) {
  for (int k = 0; k < 24; ++k) {
    AddRobustKeyframe();
    if (k <= 14) solver_.Solve(&ours_, SolverOptions());
    if (k == 16) TouchParametersOf(0);  // three fronts an update
    SolveWithoutHurry();
  }
  ExpectReference();
}

INSTANTIATE_TEST_SUITE_P(Budgets, CorrectedInPortions, testing::Values(2, 3, 5, 7, 8, 16));

/// Wildfire and budgets leave what changes little; shared variables are always exact.
class Economical : public IncrementalSolver {
 protected:
  Economical() : IncrementalSolver(Defaults()) {}
  static IncrementalOptions Defaults() {
    IncrementalOptions options;
    options.largest_step = std::numeric_limits<double>::infinity();
    return options;
  }
};

TEST_F(Economical, WildfireLeavesParametersExactAndStatesNear) {
  Start({4, -1, false}, 47);
  for (int k = 0; k < 120; ++k) {
    AddKeyframe();
    our_report_ = solver_.Solve(&ours_, SolverOptions());
    ASSERT_TRUE(our_report_.usable);
    if (k >= 60) {
      EXPECT_LT(our_report_.back_substituted, 3 * 60);
    }
    if (k % 10 == 9) {
      SolveReference();
      EXPECT_LT((ours_.eta() - reference_.eta()).norm(), 1e-9 * (1e-3 + reference_.eta().norm()))
          << k;
    }
    if (k >= 60) DropOldest();
  }
  // The rest of the pass.
  for (int i = 0; i < 3; ++i) solver_.Solve(&ours_, SolverOptions());
  SolveReference();
  double largest = 0.0;
  const IncrementalOptions options;
  for (size_t i = 0; i < ours_.keyframes().size(); ++i) {
    const auto &a = ours_.keyframes()[i].x, &b = reference_.keyframes()[i].x;
    for (size_t j = 0; j < 3; ++j) {
      largest = std::max(largest, std::abs(a[j] - b[j]) / options.relinearise_state[j]);
      largest = std::max(largest, std::abs(a[7 + j] - b[7 + j]) / options.relinearise_state[6 + j]);
    }
  }
  EXPECT_LT(largest, 1.0);
}

}  // namespace
}  // namespace test
}  // namespace odmc
