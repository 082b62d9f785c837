// Alignments along the chain end in the minimum that Ceres and dense normal equations find: to 1e-9
// of a sigma, at the start of a flight, in windows that others have left, and with parameters that
// vary or walk.
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cstdio>
#include <ostream>
#include <string>
#include <vector>

#include "odmc/estimator/estimator.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"
#include "odmc/window/ceres_window_solver.h"
#include "odmc/window/incremental_window_solver.h"
#include "odmc/window/saved_window.h"
#include "support/flight_feed.h"
#include "support/linear_window.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace test {
namespace {

using Eigen::VectorXd;
using testing_support::Drain;
using testing_support::FlightFeed;

constexpr double kSame = 1e-9;      // of a sigma
constexpr double kSettled = 1e-11;  // of a sigma, from one step to the next
constexpr int kMostSteps = 200;

/// A minimum, and the parameters' sigmas there.
struct Minimum {
  VectorXd eta, sigma;
  int steps = 0;
};

double Distance(const VectorXd& a, const VectorXd& b, const VectorXd& sigma) {
  return (a - b).cwiseQuotient(sigma).cwiseAbs().maxCoeff();
}

SolverOptions Thorough() {
  SolverOptions options;
  options.align = true;
  options.max_iterations = 50;
  options.max_time_s = 60.0;
  options.function_tolerance = 1e-14;
  return options;
}

/// Normal equations of the whole window with the parameters' priors. DenseNormal() takes the
/// prior's rotation where it was linearized.
Normal NormalAtEstimate(const Window& window) {
  Normal normal = DenseNormal(window);
  const int n = window.layout().num_estimated();
  if (window.prior().has_state) {
    const Eigen::MatrixXd& A = window.prior().A;
    Eigen::MatrixXd J = A;
    J.leftCols<kStateTangentSize>() = PriorStateJacobian(window);
    std::vector<int> columns;
    for (int i = 0; i < kStateTangentSize; ++i) columns.push_back(i);
    const auto first_bias = kStateTangentSize * static_cast<int>(window.keyframes().size());
    for (int i = 0; i < window.prior().bias_columns(); ++i) columns.push_back(first_bias + i);
    const auto end = static_cast<int>(normal.g.size());
    for (int i = 0; i < n; ++i) columns.push_back(end - n + i);
    const Eigen::MatrixXd more = J.transpose() * J - A.transpose() * A;
    const VectorXd g = (J - A).transpose() * PriorResidual(window);
    for (size_t i = 0; i < columns.size(); ++i) {
      normal.g[columns[i]] += g[static_cast<int>(i)];
      for (size_t j = 0; j < columns.size(); ++j) {
        normal.H(columns[i], columns[j]) += more(static_cast<int>(i), static_cast<int>(j));
      }
    }
  }
  const VectorXd weight = window.parameter_sigma().cwiseAbs2().cwiseInverse();
  normal.H.bottomRightCorner(n, n) += weight.asDiagonal();
  normal.g.tail(n) += weight.cwiseProduct(window.eta() - window.parameter_centre());
  return normal;
}

void Move(const VectorXd& step, Window* window) {
  int at = 0;
  for (Keyframe& k : window->keyframes()) {
    const auto from = k.x;
    StateManifold().Plus(from.data(), step.data() + at, k.x.data());
    at += kStateTangentSize;
  }
  for (Bias& b : window->biases()) {
    for (double& x : b.x) x += step[at++];
  }
  window->eta() += step.tail(window->eta().size());
}

/// Ceres, and dense Gauss-Newton steps until they end: Ceres' own end at 1e-8 of all variables.
Minimum ByCeres(Window* window) {
  EXPECT_TRUE(CeresWindowSolver().Solve(window, Thorough()).usable);
  const int n = window->layout().num_estimated();
  Minimum minimum;
  for (double moved = 1.0; moved > kSettled && minimum.steps < kMostSteps; ++minimum.steps) {
    window->MoveAnchor();
    const Normal normal = NormalAtEstimate(*window);
    const Eigen::LDLT<Eigen::MatrixXd> ldlt(normal.H);
    Eigen::MatrixXd unit = Eigen::MatrixXd::Zero(normal.g.size(), n);
    unit.bottomRows(n).setIdentity();
    minimum.sigma = ldlt.solve(unit).bottomRows(n).diagonal().cwiseSqrt();
    const VectorXd before = window->eta();
    Move(-ldlt.solve(normal.g), window);
    moved = Distance(window->eta(), before, minimum.sigma);
  }
  minimum.eta = window->eta();
  return minimum;
}

/// Alignments of a new incremental solver, one after the other until they end.
Minimum AlongChain(Window* window, const VectorXd& sigma) {
  IncrementalWindowSolver solver;
  Minimum minimum;
  for (double moved = 1.0; moved > kSettled && minimum.steps < kMostSteps; ++minimum.steps) {
    const VectorXd before = window->eta();
    const SolveReport report = solver.Solve(window, Thorough());
    EXPECT_TRUE(report.usable && report.aligned);
    moved = Distance(window->eta(), before, sigma);
  }
  minimum.eta = window->eta();
  Eigen::MatrixXd covariance;
  EXPECT_TRUE(solver.ParameterCovariance(*window, sigma, &covariance));
  minimum.sigma = covariance.diagonal().cwiseSqrt();
  return minimum;
}

/// A flight, and where it is looked at.
struct Case {
  std::string name;
  std::vector<std::string> effects;  // beside those of the nominal vehicle
  double walk_rate = 0.0;
  bool imu = false;
  double from_s = 0.0, to_s = 3.0;
  bool has_past = false;  // in all windows looked at
};

void PrintTo(const Case& c, std::ostream* out) { *out << c.name; }

class Alignment : public testing::TestWithParam<Case> {};

TEST_P(Alignment, EndsInTheMinimumOfTheWindow) {
  const Case& c = GetParam();
  SimulationOptions simulation;
  simulation.trajectory = "octo";
  simulation.duration_s = 5.0;
  SimulationNoise noise;
  noise.imu = c.imu;
  const Vehicle nominal = NominalVehicle();
  const DynamicModel truth(nominal, nominal.effects);
  const FlightLog log = Simulate(truth, DefaultTruth(truth), simulation, noise).log;
  Vehicle vehicle = nominal;
  for (const std::string& effect : c.effects) vehicle.effects.push_back(effect);
  const DynamicModel model(vehicle, vehicle.effects);
  EstimatorOptions options = OfflineOptions();
  options.keyframe_rate_hz = 25.0;
  options.window_s = 1.0;
  options.k_f_walk_rate = c.walk_rate;
  Estimator estimator(&model, options, true);

  int update = 0, compared = 0, with_past = 0;
  double worst = 0.0, worst_sigma = 0.0, least_moved = 1e300;
  estimator.SetObserver([&](const SolvedWindow& solved) {
    const double flown_s = ++update / options.keyframe_rate_hz;
    if (update % 17 != 0 || flown_s < c.from_s || flown_s > c.to_s) return;
    Window* const window = solved.window;
    const SavedWindow saved(*window);
    solved.solver->WritePrior(window);
    // From elsewhere, so that there is a way to go.
    window->eta() += 0.3 * solved.sigma_eta;
    window->keyframes().front().x[0] += 0.01;
    const SavedWindow start(*window);
    with_past += window->keyframes().front().id > 0 ? 1 : 0;
    const VectorXd from = window->eta();
    const Minimum reference = ByCeres(window);
    start.Restore(window);
    const Minimum ours = AlongChain(window, reference.sigma);
    saved.Restore(window);
    ++compared;
    least_moved = std::min(least_moved, Distance(from, reference.eta, reference.sigma));
    worst = std::max(worst, Distance(ours.eta, reference.eta, reference.sigma));
    worst_sigma = std::max(
        worst_sigma, (ours.sigma.cwiseQuotient(reference.sigma).array() - 1.0).abs().maxCoeff());
  });
  const auto see = [](const Snapshot&) {};
  for (FlightFeed feed(log); !feed.AtEnd();) {
    feed.Next(&estimator);
    Drain(&estimator, see);
  }
  std::printf("%d windows (%d with a past): %.1e sigma, sigmas %.1e, from %.2f sigma away\n",
              compared, with_past, worst, worst_sigma, least_moved);
  EXPECT_GE(compared, 3);
  EXPECT_EQ(with_past, c.has_past ? compared : 0);
  EXPECT_GT(least_moved, 0.1);
  EXPECT_LT(worst, kSame);
  EXPECT_LT(worst_sigma, kSame);
}

INSTANTIATE_TEST_SUITE_P(Windows, Alignment,
                         testing::Values(Case{"StartOfAFlight", {}, 0.0, false},
                                         Case{"StartOfAFlightWithImu", {}, 0.0, true},
                                         Case{"WithAPast", {}, 0.0, true, 3.2, 5.0, true},
                                         Case{"WithGusts", {"gust"}, 0.0, true, 1.2, 4.0, true},
                                         Case{"WithAWalk", {}, 4e-3, true, 3.2, 5.0, true}),
                         [](const auto& named) { return named.param.name; });

}  // namespace
}  // namespace test
}  // namespace odmc
