#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <limits>

#include "odmc/factors/dynamics_factor.h"
#include "odmc/sim/truth_vehicle.h"
#include "odmc/window/ceres_window_solver.h"
#include "odmc/window/marginalization.h"
#include "support/linear_window.h"

namespace odmc {
namespace test {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr double kExact = 1e-9;
constexpr double kNever = std::numeric_limits<double>::infinity();

Normal NormalOf(const LinearSystem& s) { return {s.A.transpose() * s.A, s.A.transpose() * s.b}; }

Normal SchurOf(const LinearSystem& s) {
  std::vector<int> keep;
  for (int i = s.num_eliminated; i < s.A.cols(); ++i) keep.push_back(i);
  return MarginalOf(NormalOf(s), keep);
}

// ---- Eliminate() -------------------------------------------------------------------------------

TEST(Eliminate, EqualsTheSchurComplement) {
  Random random(1);
  for (int round = 0; round < 20; ++round) {
    const LinearSystem s{random.NextMatrix(30, 17), random.NextVector(30), 9};
    EXPECT_LT(Difference(SchurOf(s), NormalOf(Eliminate(s))), kExact);
  }
}

TEST(Eliminate, LeavesTheSolutionOfTheRestAsItWas) {
  Random random(2);
  const LinearSystem s{random.NextMatrix(40, 20), random.NextVector(40), 12};
  const VectorXd whole = s.A.colPivHouseholderQr().solve(-s.b);
  const LinearSystem rest = Eliminate(s);
  const VectorXd part = rest.A.colPivHouseholderQr().solve(-rest.b);
  EXPECT_LT((part - whole.tail(8)).norm(), kExact * whole.tail(8).norm());
}

TEST(Eliminate, DoesNotSquareTheConditionNumber) {
  // Columns over ten decades: normal equations lose the small ones altogether.
  Random random(3);
  MatrixXd A = random.NextMatrix(30, 12);
  VectorXd scale(12);
  for (int i = 0; i < 12; ++i) scale[i] = std::pow(10.0, -(i % 6) * 1.0);
  const VectorXd b = random.NextVector(30);
  const LinearSystem scaled = Eliminate({A * scale.asDiagonal(), b, 6});
  const LinearSystem plain = Eliminate({A, b, 6});
  const VectorXd back = scale.tail(6).cwiseInverse();
  const Normal n = NormalOf(scaled);
  const Normal undone{back.asDiagonal() * n.H * back.asDiagonal(), back.asDiagonal() * n.g};
  EXPECT_LT(Difference(NormalOf(plain), undone), kExact);
}

TEST(Eliminate, TakesNoRowsWithEliminatedDirectionsNobodyMeasured) {
  Random random(4);
  LinearSystem s{random.NextMatrix(20, 14), random.NextVector(20), 8};
  s.A.col(2).setZero();                        // never measured
  s.A.col(5) = s.A.col(1) - 2.0 * s.A.col(3);  // only in combination
  EXPECT_LT(Difference(SchurOf(s), NormalOf(Eliminate(s))), kExact);
}

TEST(Eliminate, KeepsAsManyRowsAsThereIsInformation) {
  Random random(5);
  LinearSystem s{random.NextMatrix(40, 14), random.NextVector(40), 8};
  EXPECT_EQ(Eliminate(s).A.rows(), 6);
  s.A.col(12) = s.A.col(9) + s.A.col(10);
  s.A.col(13).setZero();
  const LinearSystem rest = Eliminate(s);
  EXPECT_EQ(rest.A.rows(), 4);
  EXPECT_EQ(rest.b.size(), 4);
  EXPECT_LT(Difference(SchurOf(s), NormalOf(rest)), kExact);
}

TEST(Eliminate, GainsNothingAlongUnobservableDirections) {
  Random random(6);
  for (int round = 0; round < 20; ++round) {
    MatrixXd A = random.NextMatrix(35, 16);
    // A direction across eliminated and remaining columns that no row sees.
    VectorXd unseen = random.NextVector(16);
    A -= (A * unseen).eval() * unseen.transpose() / unseen.squaredNorm();
    const LinearSystem rest = Eliminate({A, random.NextVector(35), 10});
    EXPECT_EQ(rest.A.rows(), 5);
    EXPECT_LT((rest.A * unseen.tail(6)).norm(), 1e-12 * rest.A.norm() * unseen.norm());
  }
}

// A prior on the parameters alone has nothing to eliminate.
TEST(Eliminate, WithoutColumnsToEliminateChangesNothing) {
  Random random(4);
  const LinearSystem s{random.NextMatrix(7, 5), random.NextVector(7), 0};
  EXPECT_LT(Difference(NormalOf(s), NormalOf(Eliminate(s))), kExact);
}

TEST(Eliminate, OfNothingOrOfTooLittleIsNothing) {
  const LinearSystem none = Eliminate({MatrixXd(0, 10), VectorXd(0), 6});
  EXPECT_EQ(none.A.rows(), 0);
  EXPECT_EQ(none.A.cols(), 4);
  Random random(7);
  // Four rows that six eliminated columns can satisfy whatever the others are.
  const LinearSystem few = Eliminate({random.NextMatrix(4, 10), random.NextVector(4), 6});
  EXPECT_EQ(few.A.rows(), 0);
  const LinearSystem zero = Eliminate({MatrixXd::Zero(8, 10), VectorXd::Zero(8), 6});
  EXPECT_EQ(zero.A.rows(), 0);
}

// ---- MarginalizeOldest(), linear factors -------------------------------------------------------

class LinearWindow : public testing::Test {
 protected:
  LinearWindow() : model_(FourParameterModel()), layout_(model_, model_.InitialValues()) {}

  VectorXd Threshold(double value) const {
    return VectorXd::Constant(layout_.num_estimated(), value);
  }

  /// Takes `count` keyframes out and compares what is left with the Schur complement of the whole.
  void ExpectSchur(const LinearWindowOptions& options, int count, int biases_gone) {
    Window window(&layout_);
    LinearWindowMaker(&window, options, 17).Fill();
    window.eta() += Random(3).NextVector(layout_.num_estimated(), 0.3);
    const Normal expected = MarginalOf(DenseNormal(window), Remaining(window, count, biases_gone));
    for (int i = 0; i < count; ++i) {
      ASSERT_TRUE(MarginalizeOldest(&window, Threshold(kNever)));
      EXPECT_LE(window.prior().A.rows(), window.prior().A.cols());
    }
    EXPECT_LT(Difference(expected, DenseNormal(window)), kExact);
  }

  DynamicModel model_;
  ParameterLayout layout_;
};

using Marginalization = LinearWindow;

TEST_F(Marginalization, OfOneKeyframeEqualsTheSchurComplement) {
  ExpectSchur(LinearWindowOptions(), 1, 0);
}

TEST_F(Marginalization, OfManyKeyframesEqualsTheSchurComplement) {
  LinearWindowOptions options;
  options.keyframes = 12;
  ExpectSchur(options, 9, 0);
}

TEST_F(Marginalization, OfTheLastKeyframeLeavesTheParameters) {
  LinearWindowOptions options;
  options.keyframes = 4;
  Window window(&layout_);
  LinearWindowMaker(&window, options, 19).Fill();
  const Normal expected = MarginalOf(DenseNormal(window), Remaining(window, 4, 0));
  for (int i = 0; i < 4; ++i) ASSERT_TRUE(MarginalizeOldest(&window, Threshold(kNever)));
  EXPECT_TRUE(window.keyframes().empty());
  EXPECT_FALSE(window.prior().has_state);
  EXPECT_LT(Difference(expected, DenseNormal(window)), kExact);
}

TEST_F(Marginalization, TakesTheBiasWithTheLastKeyframeThatHasIt) {
  LinearWindowOptions options;
  options.keyframes = 9;
  options.keyframes_per_bias = 3;
  ExpectSchur(options, 2, 0);
  ExpectSchur(options, 3, 1);
  ExpectSchur(options, 7, 2);
  Window window(&layout_);
  LinearWindowMaker(&window, options, 17).Fill();
  for (int i = 0; i < 3; ++i) {
    EXPECT_EQ(window.biases().size(), 3u);
    ASSERT_TRUE(MarginalizeOldest(&window, Threshold(kNever)));
  }
  EXPECT_EQ(window.biases().size(), 2u);
  EXPECT_EQ(window.biases().front().id, 1);
  EXPECT_TRUE(window.prior().has_bias);
  EXPECT_TRUE(window.biases().front().in_prior);
}

TEST_F(Marginalization, TiesNothingAcrossUnlinkedChains) {
  LinearWindowOptions options;
  options.unlinked = 3;
  ExpectSchur(options, 3, 0);
  ExpectSchur(options, 5, 0);
  Window window(&layout_);
  LinearWindowMaker(&window, options, 17).Fill();
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(MarginalizeOldest(&window, Threshold(kNever)));
  EXPECT_FALSE(window.prior().has_state);
  EXPECT_FALSE(window.keyframes().front().in_prior);
  EXPECT_EQ(window.prior().A.cols(), layout_.num_estimated());
  EXPECT_GT(window.prior().A.rows(), 0);
}

TEST_F(Marginalization, KeepsTheBiasAcrossUnlinkedChains) {
  LinearWindowOptions options;
  options.unlinked = 2;
  options.keyframes_per_bias = 4;
  ExpectSchur(options, 2, 0);
  ExpectSchur(options, 3, 0);
}

TEST_F(Marginalization, SurvivesStatesThatNobodyMeasured) {
  LinearWindowOptions options;
  options.with_rotation = false;  // three directions of every state without a factor
  ExpectSchur(options, 4, 0);
}

TEST_F(Marginalization, LeavesUnobservableDirectionsFree) {
  LinearWindowOptions options;
  options.keyframes = 10;
  options.position_seen = false;
  options.unseen_parameters = Random(8).NextVector(layout_.num_estimated());
  Window window(&layout_);
  LinearWindowMaker(&window, options, 21).Fill();
  Random random(22);
  for (int i = 0; i < 8; ++i) {
    // Where the estimate wanders must not matter.
    for (Keyframe& k : window.keyframes()) {
      for (int j = 0; j < 3; ++j) k.x[j] += random.Next(0.5);
    }
    window.eta() += random.NextVector(layout_.num_estimated(), 0.5);
    ASSERT_TRUE(MarginalizeOldest(&window, Threshold(0.1)));
    const MatrixXd& A = window.prior().A;
    const double size = A.norm();
    EXPECT_LT(A.leftCols(3).norm(), 1e-11 * size) << "the place of all keyframes together";
    EXPECT_LT((A.rightCols(layout_.num_estimated()) * options.unseen_parameters).norm(),
              1e-11 * size);
    EXPECT_GT(size, 0.1);
  }
}

/// Slides over a long linear problem with solves in between; the answer must be that of the batch.
void ExpectBatchAnswer(const ParameterLayout& layout, double threshold, int keyframes_per_bias) {
  constexpr int kAll = 30, kHeld = 5;
  LinearWindowOptions options;
  options.keyframes = kAll;
  options.keyframes_per_bias = keyframes_per_bias;
  const int n = layout.num_estimated();
  Window batch(&layout);
  LinearWindowMaker(&batch, options, 33).Fill();
  Normal normal = DenseNormal(batch);
  const VectorXd inverse = batch.parameter_sigma().cwiseInverse();
  normal.H.bottomRightCorner(n, n) += inverse.cwiseAbs2().asDiagonal();
  normal.g.tail(n) += inverse.cwiseAbs2().cwiseProduct(batch.eta() - batch.parameter_centre());
  const VectorXd eta = batch.eta() - normal.H.ldlt().solve(normal.g).tail(n);

  Window window(&layout);
  LinearWindowMaker maker(&window, options, 33);
  CeresWindowSolver solver;
  SolverOptions solver_options;
  solver_options.max_iterations = 20;
  solver_options.max_time_s = 5.0;
  solver_options.function_tolerance = 1e-16;
  for (int k = 0; k < kAll; ++k) {
    maker.AddKeyframe();
    ASSERT_TRUE(solver.Solve(&window, solver_options).usable);
    while (window.keyframes().size() > kHeld) {
      ASSERT_TRUE(MarginalizeOldest(&window, VectorXd::Constant(n, threshold)));
    }
  }
  ASSERT_TRUE(solver.Solve(&window, solver_options).usable);
  EXPECT_LT((window.eta() - eta).norm(), 1e-8 * std::max(1.0, eta.norm()));
  // At the optimum of one, the gradient of the other is zero: no solver in between.
  Normal left = DenseNormal(window);
  left.H.bottomRightCorner(n, n) += inverse.cwiseAbs2().asDiagonal();
  left.g.tail(n) += inverse.cwiseAbs2().cwiseProduct(window.eta() - window.parameter_centre());
  const VectorXd exact = window.eta() - left.H.ldlt().solve(left.g).tail(n);
  EXPECT_LT((exact - eta).norm(), kExact * std::max(1.0, eta.norm()));
}

TEST_F(Marginalization, SlidingOverALinearProblemGivesTheBatchAnswer) {
  ExpectBatchAnswer(layout_, kNever, 0);
}

TEST_F(Marginalization, MovingTheParametersPointDoesNotChangeTheAnswer) {
  ExpectBatchAnswer(layout_, 1e-6, 0);
  ExpectBatchAnswer(layout_, 0.05, 0);
}

TEST_F(Marginalization, SlidingWithBiasesGivesTheBatchAnswer) {
  ExpectBatchAnswer(layout_, 0.05, 4);
}

TEST_F(Marginalization, KeepsTheLinearizationPointsOfWhatThePriorTouches) {
  LinearWindowOptions options;
  options.keyframes_per_bias = 10;
  Window window(&layout_);
  LinearWindowMaker(&window, options, 23).Fill();
  const auto x = window.keyframes()[1].x;
  const ParameterVector eta_lin = window.prior().eta_lin;
  window.eta()[0] += 0.01;
  ASSERT_TRUE(MarginalizeOldest(&window, Threshold(0.05)));
  EXPECT_EQ(window.prior().eta_lin, eta_lin);
  EXPECT_TRUE(window.keyframes().front().in_prior);
  EXPECT_EQ(window.keyframes().front().x_lin, x);
  const auto bias_lin = window.biases().front().x_lin;
  // The estimate moves; the points stay, and the residual follows the prior's own slope.
  const VectorXd before = PriorResidual(window);
  window.keyframes().front().x[0] += 0.3;
  window.biases().front().x[4] -= 0.2;
  window.eta()[2] += 0.02;
  const MatrixXd& A = window.prior().A;
  const VectorXd expected = before + 0.3 * A.col(0) - 0.2 * A.col(12 + 4) + 0.02 * A.col(18 + 2);
  EXPECT_LT((PriorResidual(window) - expected).norm(), 1e-12);
  EXPECT_EQ(window.keyframes().front().x_lin, x);
  ASSERT_TRUE(MarginalizeOldest(&window, Threshold(0.05)));
  EXPECT_EQ(window.biases().front().x_lin, bias_lin);
  EXPECT_EQ(window.prior().eta_lin, eta_lin);
  // Beyond the threshold the prior moves as a whole.
  window.eta()[1] += 0.5;
  ASSERT_TRUE(MarginalizeOldest(&window, Threshold(0.05)));
  EXPECT_EQ(window.prior().eta_lin, window.eta());
}

TEST_F(Marginalization, ScoreIsTheGradientOfTheLeavingParameterFactors) {
  Window window(&layout_);
  LinearWindowMaker(&window, LinearWindowOptions(), 25).Fill();
  VectorXd expected = VectorXd::Zero(layout_.num_estimated());
  for (const Factor& factor : window.keyframes().front().factors) {
    if (!factor.parameters) continue;
    LinearFactor linear;
    ASSERT_TRUE(Linearize(window, factor, false, &linear));
    expected += linear.J.rightCols(layout_.num_estimated()).transpose() * linear.r;
  }
  LeavingFactors leaving;
  ASSERT_TRUE(MarginalizeOldest(&window, Threshold(kNever), &leaving));
  EXPECT_LT((leaving.score - expected).norm(), 1e-12);
}

/// What a prior's information says of its last four columns, the parameters, with the state
/// eliminated.
MatrixXd OfParametersAlone(const MatrixXd& H) {
  const auto of_state = H.cols() - 4;
  const MatrixXd across = H.topRightCorner(of_state, 4);
  return H.bottomRightCorner(4, 4) -
         across.transpose() *
             H.topLeftCorner(of_state, of_state).completeOrthogonalDecomposition().solve(across);
}

TEST_F(Marginalization, RescaledPriorKeepsItsOptimumAndWhatItSaysOfTheState) {
  Window window(&layout_);
  LinearWindowMaker(&window, LinearWindowOptions(), 27).Fill();
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(MarginalizeOldest(&window, Threshold(kNever)));
  Prior& prior = window.prior();
  const auto of_state = prior.A.cols() - 4;
  const MatrixXd before = prior.A.transpose() * prior.A;
  const VectorXd optimum = -prior.A.completeOrthogonalDecomposition().solve(prior.b);
  constexpr double kScale = 0.4;
  const MatrixXd root = RescalePrior(VectorXd::Constant(4, kScale), &window);
  const MatrixXd after = prior.A.transpose() * prior.A;
  EXPECT_LT((after.leftCols(of_state) - before.leftCols(of_state)).norm(), kExact * before.norm());
  EXPECT_LT((OfParametersAlone(after) - kScale * OfParametersAlone(before)).norm(),
            kExact * before.norm());
  EXPECT_LT((root - std::sqrt(kScale) * MatrixXd::Identity(4, 4)).norm(), kExact);
  const VectorXd gradient = prior.A.transpose() * (prior.b + prior.A * optimum);
  EXPECT_LT(gradient.norm(), kExact * before.norm());
}

// A combination that nobody has seen, of parameters with different scales.
TEST_F(Marginalization, RescaledPriorMakesNothingUp) {
  Window window(&layout_);
  LinearWindowMaker(&window, LinearWindowOptions(), 27).Fill();
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(MarginalizeOldest(&window, Threshold(kNever)));
  Prior& prior = window.prior();
  const auto columns = prior.A.cols();
  prior.A = MatrixXd::Zero(3, columns);
  prior.A(0, columns - 4) = prior.A(0, columns - 3) = 1e3;  // their sum; the difference hardly
  prior.A(1, columns - 4) = 1e-5;
  prior.A(1, columns - 3) = -1e-5;
  prior.A(2, columns - 1) = 7.0;
  prior.b = Eigen::Vector3d(0.3, 1.0, 2.0);  // an optimum far out
  window.eta() = prior.eta_lin;
  std::copy(window.keyframes().front().x_lin.begin(), window.keyframes().front().x_lin.end(),
            window.keyframes().front().x.begin());
  const double before = PriorResidual(window).norm();
  VectorXd scale(4);
  scale << 0.25, 1.0, 3.0, 4.0;
  for (int i = 0; i < 20; ++i) {
    RescalePrior(scale, &window);
    RescalePrior(scale.cwiseInverse(), &window);
  }
  RescalePrior(scale, &window);
  VectorXd difference = VectorXd::Zero(columns), sum = difference;
  difference[columns - 4] = sum[columns - 4] = sum[columns - 3] = 1.0;
  difference[columns - 3] = -1.0;
  EXPECT_LT((prior.A * difference).norm(), 2.1e-5);
  EXPECT_NEAR((prior.A * sum).norm(), 2e3 * std::pow(0.25, 0.25), 1e-6);  // geometric mean
  EXPECT_NEAR(prior.A.col(columns - 1).norm(), 14.0, 1e-9);
  EXPECT_LT(PriorResidual(window).norm(), 2.0 * before);
}

TEST_F(Marginalization, AWalkWidensTheParametersAlongItsDirectionAndNothingElse) {
  Window window(&layout_);
  LinearWindowMaker(&window, LinearWindowOptions(), 27).Fill();
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(MarginalizeOldest(&window, Threshold(kNever)));
  Prior& prior = window.prior();
  const auto of_state = prior.A.cols() - 4;
  const MatrixXd before = prior.A.transpose() * prior.A;
  const VectorXd optimum = -prior.A.completeOrthogonalDecomposition().solve(prior.b);
  const VectorXd d = (VectorXd(4) << 0.5, 0.0, -1.5, 0.0).finished();
  constexpr double kVariance = 0.3;
  LetPriorWalk(d, kVariance, &window);
  const MatrixXd after = prior.A.transpose() * prior.A;
  EXPECT_LT((after.leftCols(of_state) - before.leftCols(of_state)).norm(), kExact * before.norm());
  const MatrixXd wider = OfParametersAlone(before).inverse() + kVariance * d * d.transpose();
  EXPECT_LT((OfParametersAlone(after).inverse() - wider).norm(), 1e-8 * wider.norm());
  const VectorXd gradient = prior.A.transpose() * (prior.b + prior.A * optimum);
  EXPECT_LT(gradient.norm(), kExact * before.norm());
}

TEST_F(Marginalization, AProcessStepIsThatOfAKalmanFilter) {
  Window window(&layout_);
  LinearWindowMaker(&window, LinearWindowOptions(), 28).Fill();
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(MarginalizeOldest(&window, Threshold(kNever)));
  Prior& prior = window.prior();
  // Some is known of everything, so that there is a covariance.
  const auto n = prior.A.cols();
  prior.A.conservativeResize(prior.A.rows() + n, n);
  prior.A.bottomRows(n).setIdentity();
  prior.b.conservativeResize(prior.b.size() + n);
  prior.b.tail(n).setConstant(0.3);
  constexpr int kIndex = 2;
  constexpr double kDecay = 0.8, kVariance = 0.7;
  const auto column = n - 4 + kIndex;
  const auto covariance = [&prior] { return (prior.A.transpose() * prior.A).inverse().eval(); };
  const auto mean = [&] {
    VectorXd x = -prior.A.colPivHouseholderQr().solve(prior.b);
    x[column] += prior.eta_lin[kIndex];
    return x;
  };
  prior.eta_lin[kIndex] = 5.0;
  VectorXd x = mean();
  MatrixXd P = covariance();
  LetPriorVary(kIndex, {kDecay, kVariance}, &prior);
  x[column] *= kDecay;
  P.row(column) *= kDecay;
  P.col(column) *= kDecay;
  P(column, column) += kVariance;
  EXPECT_LT((covariance() - P).norm(), kExact * P.norm());
  EXPECT_LT((mean() - x).norm(), kExact * x.norm());
}

// ---- Nonlinear factors -------------------------------------------------------------------------

/// A few keyframes of flight with odometry, kinematics and dynamics.
class FlightWindow : public testing::Test {
 protected:
  FlightWindow()
      : vehicle_(NominalVehicle()),
        model_(vehicle_, vehicle_.effects),
        layout_(model_, DefaultTruth(model_)) {}

  void Fill(Window* window, bool with_odometry, int count = 6) {
    Random random(51);
    window->eta() = layout_.Encode(DefaultTruth(model_));
    State s;
    s.q_WS = Exp(random.Next3(0.4));
    s.v_WS = random.Next3(3.0);
    s.w_WS_S = random.Next3(2.0);
    for (int k = 0; k < count; ++k) {
      const std::int64_t id = window->AddKeyframe(k * 10000000, s, k > 0, -1);
      if (with_odometry) {
        OdometrySample z;
        z.p_WS = s.p_WS + random.Next3(0.01);
        z.q_WS = s.q_WS * Exp(random.Next3(0.003));
        z.v_WS = s.v_WS + random.Next3(0.03);
        z.w_WS_S = s.w_WS_S + random.Next3(0.01);
        Add(window, FactorKind::kOdometry,
            std::make_unique<OdometryFactor>(z, OdometryNoise(), true), id, -1, false);
      } else {
        // Attitude, velocity and rates only.
        Eigen::MatrixXd M = 100.0 * random.NextMatrix(9, 12);
        M.leftCols<3>().setZero();
        Add(window, FactorKind::kOther,
            std::make_unique<LinearCost>(random.NextVector(9), std::vector<Eigen::MatrixXd>{M}, 1),
            id, -1, false);
      }
      if (k > 0) {
        Add(window, FactorKind::kKinematic,
            std::make_unique<KinematicFactor>(0.01, DynamicsForm::kMidpoint, 5e-4, 5e-4, true),
            id - 1, id, false);
        DynamicsMeasurement measurement;
        measurement.dt = 0.01;
        RotorVector speed(4);
        for (int j = 0; j < 4; ++j) speed[j] = 1100.0 + random.Next(100.0);
        measurement.rotors = RotorState::Steady(speed);
        DynamicsNoise noise;
        noise.nominal_inertia = vehicle_.inertia_kg_m2;
        Add(window, FactorKind::kDynamics,
            std::make_unique<DynamicsFactor>(measurement, noise, true, &model_, &layout_), id - 1,
            id, true);
      }
      s.p_WS += 0.01 * s.v_WS;
      s.q_WS = s.q_WS * Exp(0.01 * s.w_WS_S);
      s.v_WS += random.Next3(0.05);
      s.w_WS_S += random.Next3(0.05);
    }
  }

  static void Add(Window* window, FactorKind kind, std::unique_ptr<ceres::CostFunction> cost,
                  std::int64_t s0, std::int64_t s1, bool parameters) {
    Factor factor;
    factor.kind = kind;
    factor.cost = std::move(cost);
    factor.state0 = s0;
    factor.state1 = s1;
    factor.parameters = parameters;
    window->AddFactor(std::move(factor));
  }

  Vehicle vehicle_;
  DynamicModel model_;
  ParameterLayout layout_;
};

using MarginalizationOfFlight = FlightWindow;

TEST_F(MarginalizationOfFlight, EqualsTheFullProblemWhereItIsLinearized) {
  Window window(&layout_);
  Fill(&window, true);
  window.prior().eta_lin = window.eta();
  const Normal expected = MarginalOf(DenseNormal(window), Remaining(window, 3, 0));
  const VectorXd threshold = VectorXd::Constant(layout_.num_estimated(), kNever);
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(MarginalizeOldest(&window, threshold));
  EXPECT_LT(Difference(expected, DenseNormal(window)), 1e-7);
}

TEST_F(MarginalizationOfFlight, TakesJacobiansWhereThePriorHasThem) {
  Window window(&layout_);
  Fill(&window, true);
  window.prior().eta_lin = window.eta();
  const VectorXd threshold = VectorXd::Constant(layout_.num_estimated(), kNever);
  ASSERT_TRUE(MarginalizeOldest(&window, threshold));
  Keyframe& front = window.keyframes().front();
  const auto x_lin = front.x_lin;
  // The front keyframe and the parameters move by what a solve may move them.
  Random random(52);
  const VectorXd d = random.NextVector(12, 0.05);
  StateManifold().Plus(x_lin.data(), d.data(), front.x.data());
  const VectorXd step = random.NextVector(layout_.num_estimated(), 0.02);
  window.eta() += step;

  // By hand: prior and factors as affine functions of the offsets from their points.
  const int n = layout_.num_estimated();
  MatrixXd J = MatrixXd::Zero(0, 24 + n);
  VectorXd r;
  const auto append = [&](const MatrixXd& rows, const VectorXd& value) {
    J.conservativeResize(J.rows() + rows.rows(), 24 + n);
    J.bottomRows(rows.rows()) = rows;
    r.conservativeResize(r.size() + value.size());
    r.tail(value.size()) = value;
  };
  MatrixXd prior = MatrixXd::Zero(window.prior().A.rows(), 24 + n);
  prior.leftCols(12) = window.prior().A.leftCols(12);
  prior.rightCols(n) = window.prior().A.rightCols(n);
  append(prior, window.prior().b);
  for (const Factor& factor : front.factors) {
    LinearFactor now, there;
    ASSERT_TRUE(Linearize(window, factor, false, &now));
    const auto x = front.x;
    const ParameterVector eta = window.eta();
    front.x = x_lin;
    window.eta() = window.prior().eta_lin;
    ASSERT_TRUE(Linearize(window, factor, false, &there));
    front.x = x;
    window.eta() = eta;
    MatrixXd rows = MatrixXd::Zero(there.r.size(), 24 + n);
    if (there.state0 >= 0) rows.leftCols(12) = there.J.middleCols(there.state0, 12);
    if (there.state1 >= 0) rows.middleCols(12, 12) = there.J.middleCols(there.state1, 12);
    if (there.parameters >= 0) rows.rightCols(n) = there.J.middleCols(there.parameters, n);
    append(rows, now.r - rows.leftCols(12) * d - rows.rightCols(n) * step);
  }
  const LinearSystem expected = Eliminate({J, r, 12});
  ASSERT_TRUE(MarginalizeOldest(&window, threshold));
  const LinearSystem got{window.prior().A, window.prior().b, 0};
  EXPECT_LT(Difference(NormalOf(expected), NormalOf(got)), 1e-7);
}

TEST_F(MarginalizationOfFlight, GainsNothingAboutThePlaceWithoutPositions) {
  Window window(&layout_);
  Fill(&window, false, 10);
  const VectorXd threshold = VectorXd::Constant(layout_.num_estimated(), 0.1);
  Random random(53);
  for (int i = 0; i < 7; ++i) {
    for (Keyframe& k : window.keyframes()) {
      VectorXd d = random.NextVector(12, 0.02);
      auto x = k.x;
      StateManifold().Plus(x.data(), d.data(), k.x.data());
    }
    ASSERT_TRUE(MarginalizeOldest(&window, threshold));
    const MatrixXd& A = window.prior().A;
    ASSERT_GT(A.rows(), 0);
    EXPECT_LT(A.leftCols(3).norm(), 1e-9 * A.norm());
    EXPECT_GT(A.middleCols(6, 3).norm(), 1e-3 * A.norm());
  }
}

TEST_F(MarginalizationOfFlight, LeavesOutAFactorThatCannotBeEvaluated) {
  Window window(&layout_);
  Fill(&window, true);
  window.keyframes().front().x[8] = std::nan("");
  const VectorXd threshold = VectorXd::Constant(layout_.num_estimated(), kNever);
  EXPECT_FALSE(MarginalizeOldest(&window, threshold));
  EXPECT_EQ(window.keyframes().size(), 5u);
  EXPECT_TRUE(window.prior().A.allFinite());
  EXPECT_TRUE(window.prior().b.allFinite());
}

}  // namespace
}  // namespace test
}  // namespace odmc
