// Wind through a drag that is fitted beside it.

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <vector>

#include "odmc/attribution/gust_case.h"
#include "odmc/attribution/gust_likelihood.h"
#include "odmc/math/gaussian.h"

namespace odmc {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double kNatural = 0.5;  // natural size of a drag coefficient [N s/m]
constexpr double kDuration_s = 30.0;
constexpr TimeConstantPrior kPrior{2.0, 0.7};

/// A flight along an eight, turning and rolling, that goes `speed` m/s at most.
FlightMotion Eight(double speed) {
  FlightMotion motion;
  motion.step_s = ThinnedFlight::kStep_s;
  for (double t = 0.0; t < kDuration_s; t += motion.step_s) {
    FilteredMotion sample;
    sample.t_s = t;
    sample.R_WS = (Eigen::AngleAxisd(0.6 * t, Vector3d::UnitZ()) *
                   Eigen::AngleAxisd(0.4 * std::sin(1.3 * t), Vector3d::UnitX()))
                      .toRotationMatrix();
    sample.v_WS = speed * Vector3d(std::sin(t), std::cos(2.0 * t), 0.5 * std::sin(1.7 * t));
    sample.p_WS = speed * Vector3d(-std::cos(t), 0.5 * std::sin(2.0 * t), -std::cos(1.7 * t) / 3.4);
    sample.follows = t > 0.0;
    motion.samples.push_back(sample);
  }
  return motion;
}

/// A first-order process of each axis at the flight's samples.
std::vector<Vector3d> Wander(int n, double sigma, double time_constant_s, Gaussian* random) {
  const double decay = std::exp(-ThinnedFlight::kStep_s / time_constant_s);
  std::vector<Vector3d> x = {sigma * random->Next3()};
  while (static_cast<int>(x.size()) < n) {
    x.push_back(decay * x.back() + std::sqrt(1.0 - decay * decay) * sigma * random->Next3());
  }
  return x;
}

/// What a model with the drag `believed` leaves of a force, and how it says that force answers.
struct Case {
  ThinnedFlight flight;
  Vector3d believed;
  ResidualModel::Wrenches residual;
  WindDerivatives d_wind;
  std::vector<DragCoefficient> drag;

  Case(double speed, const Vector3d& believed_drag, const Vector3d& true_drag,
       const std::vector<Vector3d>& wind_W, const std::vector<Vector3d>& force_W)
      : flight(Eight(speed), BlockSplit()), believed(believed_drag) {
    const int n = flight.size();
    Gaussian random(7, 0);
    residual.setZero(n, kNumChannels);
    for (WindDerivatives::value_type& d : d_wind) d.setZero(n, kNumChannels);
    for (int axis = 0; axis < 3; ++axis) {
      DragCoefficient c{axis, kNatural, residual, d_wind, -4.0, -believed[axis] / kNatural};
      for (int i = 0; i < n; ++i) {
        const Matrix3d R_BW = flight.sample(i).R_WS.transpose();
        const Vector3d u_B = R_BW * flight.sample(i).v_WS;
        c.d_wrench(i, axis) = kNatural * u_B[axis];
        for (int k = 0; k < 3; ++k) c.d_wind[k](i, axis) = -kNatural * R_BW(axis, k);
      }
      drag.push_back(c);
    }
    for (int i = 0; i < n; ++i) {
      const Matrix3d R_BW = flight.sample(i).R_WS.transpose();
      const Vector3d air_B = R_BW * (flight.sample(i).v_WS - wind_W[i]);
      const Vector3d force_B = true_drag.cwiseProduct(air_B) + R_BW * force_W[i];
      residual.row(i).head<3>() =
          force_B + 0.1 * random.Next3() - believed.cwiseProduct(R_BW * flight.sample(i).v_WS);
      for (int k = 0; k < 3; ++k) {
        d_wind[k].row(i).head<3>() = -believed.cwiseProduct(R_BW.col(k)).transpose();
      }
    }
  }

  GustTest Test() const { return TestGusts(flight, residual, d_wind, drag, kPrior); }
  GustTest TestWithoutDrag() const { return TestGusts(flight, residual, d_wind, {}, kPrior); }

  Vector3d FittedDrag(const GustTest& test) const { return believed + kNatural * test.drag; }
};

const Vector3d kTrueDrag(-0.62, -0.45, -0.38);
const int kSamples = ThinnedFlight(Eight(1.0), BlockSplit()).size();
const std::vector<Vector3d> kNothing(kSamples, Vector3d::Zero());

Case Windy(double speed, const Vector3d& believed, int seed = 3) {
  Gaussian random(seed, 0);
  return Case(speed, believed, kTrueDrag, Wander(kSamples, 2.0, 1.5, &random), kNothing);
}

Case Pushed(const Vector3d& believed, int seed) {
  Gaussian random(seed, 0);
  return Case(3.0, believed, kTrueDrag, kNothing, Wander(kSamples, 1.0, 1.5, &random));
}

const Vector3d kWrongDrag(-0.37, -0.5, -0.14);

TEST(GustTest, FitsTheDragBesideTheWind) {
  for (int seed = 3; seed < 9; ++seed) {
    SCOPED_TRACE(seed);
    const Case windy = Windy(3.0, kWrongDrag, seed);
    EXPECT_LT(windy.TestWithoutDrag().over_others, -20.0);
    const GustTest test = windy.Test();
    EXPECT_GT(test.over_others, 0.0);
    EXPECT_GT(test.over_place, -5.0);  // wind follows no place
    EXPECT_GT(test.gain, 300.0);
    EXPECT_NEAR(std::log(test.sigma_m_s / 2.0), 0.0, 3.0 * test.sigma_error);
    EXPECT_NEAR(std::log(test.time_constant_s / 1.5), 0.0, 3.0 * test.time_constant_error);
    EXPECT_LT(test.sigma_error, 0.35);  // 30 s hold some ten correlation times
    EXPECT_LT(test.time_constant_error, 0.5);
    const Vector3d drag = windy.FittedDrag(test);
    for (int k = 0; k < 3; ++k) {
      const double sigma = kNatural * test.drag_sigma[k];
      EXPECT_NEAR(drag[k], kTrueDrag[k], 3.0 * sigma) << k;
      EXPECT_LT(sigma, 0.15) << k;  // nobody knows the noise and the steady force beside it
    }
  }
}

// Over many flights the errors are as large as the standard errors say.
TEST(GustTest, StandardErrorsHold) {
  constexpr int kFlights = 16;
  double size = 0.0, time_constant = 0.0;
  for (int seed = 20; seed < 20 + kFlights; ++seed) {
    const GustTest test = Windy(3.0, kWrongDrag, seed).Test();
    size += std::pow(std::log(test.sigma_m_s / 2.0) / test.sigma_error, 2);
    time_constant += std::pow(std::log(test.time_constant_s / 1.5) / test.time_constant_error, 2);
  }
  // Quantiles of chi square with 16 degrees of freedom, 0.1 % and 99.9 %.
  for (const double sum : {size, time_constant}) {
    EXPECT_GT(sum, 3.94);
    EXPECT_LT(sum, 39.3);
  }
}

// Wind that turns no corners changes less over short times than a first-order process does.
TEST(GustTest, ASmoothWindHasItsCorrelationTime) {
  constexpr double kTimeConstant_s = 2.4, kSmoothed_s = 0.5;
  constexpr double kWhole_s = kTimeConstant_s + kSmoothed_s;  // integral of the correlation
  constexpr int kFlights = 8;
  double mean = 0.0;
  for (int seed = 40; seed < 40 + kFlights; ++seed) {
    Gaussian random(seed, 0);
    std::vector<Vector3d> wind = Wander(kSamples, 2.0, kTimeConstant_s, &random);
    const double share = 1.0 - std::exp(-ThinnedFlight::kStep_s / kSmoothed_s);
    for (int i = 1; i < kSamples; ++i) wind[i] = wind[i - 1] + share * (wind[i] - wind[i - 1]);
    const GustTest test = Case(3.0, kTrueDrag, kTrueDrag, wind, kNothing).Test();
    mean += std::log(test.time_constant_s / kWhole_s) / kFlights;
  }
  EXPECT_NEAR(mean, 0.0, 0.25);
}

TEST(GustTest, WhatWasBelievedOfTheDragMattersNot) {
  const GustTest wrong = Windy(3.0, kWrongDrag).Test(), right = Windy(3.0, kTrueDrag).Test();
  EXPECT_NEAR(wrong.over_others, right.over_others, 2.0);
  EXPECT_NEAR(wrong.sigma_m_s, right.sigma_m_s, 0.1);
}

TEST(GustTest, NoiseGainsNothingByTheDragThatIsFittedBeside) {
  for (const double speed : {0.2, 1.0, 3.0}) {
    const Case still(speed, kWrongDrag, kTrueDrag, kNothing, kNothing);
    EXPECT_LT(still.Test().gain, std::log(100.0)) << speed;
  }
}

TEST(GustTest, AForceOfUnequalSizesIsNone) {
  for (int seed = 3; seed < 6; ++seed) {
    Gaussian random(seed, 0);
    std::vector<Vector3d> tether = Wander(kSamples, 1.0, 1.5, &random);
    const ThinnedFlight eight(Eight(3.0), BlockSplit());
    for (int i = 0; i < kSamples; ++i) {  // Case takes it in the world
      tether[i] =
          eight.sample(i).R_WS * Vector3d(tether[i].x(), 0.2 * tether[i].y(), tether[i].z());
    }
    const GustTest test = Case(3.0, kTrueDrag, kTrueDrag, kNothing, tether).Test();
    EXPECT_GT(test.gain, 100.0) << seed;
    EXPECT_LT(test.over_others, -std::log(100.0)) << seed;  // clearly better without wind
  }
}

TEST(GustTest, AForceFreeOfTheDragDoesBetterAsOne) {
  double sum = 0.0;
  for (int seed = 3; seed < 9; ++seed) {
    const double over_others = Pushed(kWrongDrag, seed).Test().over_others;
    EXPECT_LT(over_others, std::log(100.0)) << seed;
    sum += over_others / 6.0;
  }
  EXPECT_LT(sum, -2.0);
}

TEST(GustTest, FindsDragWhereNextToNoneWasBelieved) {
  const Case windy = Windy(0.2, {0.0, 0.0, -0.4});  // too slow to tell drag without wind
  EXPECT_LT(windy.TestWithoutDrag().over_others, -20.0);
  EXPECT_GT(windy.Test().over_others, -3.0);
}

TEST(GustTest, AForceThatSwingsSteadilyIsNone) {
  std::vector<Vector3d> swing;
  for (int i = 0; i < kSamples; ++i) {
    const double t = i * ThinnedFlight::kStep_s;
    swing.emplace_back(0.15 * std::sin(5.0 * t), 0.05 * std::cos(5.0 * t), 0.1 * std::sin(5.0 * t));
  }
  EXPECT_LT(Case(0.2, kTrueDrag, kTrueDrag, kNothing, swing).Test().over_others, -20.0);
}

// As of a magnet beside the course.
TEST(GustTest, AForceThatDependsOnThePlaceIsNone) {
  const ThinnedFlight eight(Eight(2.0), BlockSplit());
  std::vector<Vector3d> field;
  for (int i = 0; i < eight.size(); ++i) {
    const Vector3d from = eight.sample(i).p_WS - Vector3d(1.0, 0.5, 0.3);
    field.push_back(1.5 * std::exp(-from.squaredNorm()) * Vector3d(1.0, -0.5, 0.2));
  }
  EXPECT_LT(Case(2.0, kTrueDrag, kTrueDrag, kNothing, field).Test().over_place, -20.0);
}

// A tether is slack near its anchor, and drags: part of its force has nothing to do with the place.
TEST(GustTest, ATetherIsNone) {
  const ThinnedFlight eight(Eight(2.0), BlockSplit());
  Gaussian random(5, 0);
  std::vector<Vector3d> pull = Wander(kSamples, 0.1, 1.5, &random);
  pull.resize(static_cast<size_t>(eight.size()), Vector3d::Zero());
  for (int i = 0; i < eight.size(); ++i) {
    const Vector3d from = eight.sample(i).p_WS - Vector3d(0.0, 0.0, -1.0);
    const double taut = std::max(0.0, from.norm() - 1.5);
    pull[static_cast<size_t>(i)] -= 0.8 * taut * from.normalized();
  }
  const GustTest test = Case(2.0, kTrueDrag, kTrueDrag, kNothing, pull).Test();
  EXPECT_GT(test.gain, 100.0);
  EXPECT_LT(test.over_place, -20.0);
}

// Wind through drag is nearly a free force, and of the two wind is known to act.
TEST(GustCase, MayTieWithAForceThatNoWindMakes) {
  const AttributionOptions options;
  GustCase gusts;
  gusts.test.gain = options.gust_price + 20.0;
  gusts.test.sigma_m_s = 1.0;
  gusts.test.peakedness_p = 0.5;
  gusts.test.over_place = 1.0 - options.clear_odds;
  gusts.test.over_others = 1.0 - options.clear_odds;
  EXPECT_TRUE(IsGusty(gusts, options));
  GustCase others = gusts;
  others.test.over_others = -2.5 - options.clear_odds;
  EXPECT_FALSE(IsGusty(others, options));
  // Of much that gusts explain, some is the form of the drag.
  others.test.gain = 500.0;
  EXPECT_TRUE(IsGusty(others, options));
  others.test.over_others = -16.0 - options.clear_odds;
  EXPECT_FALSE(IsGusty(others, options));
  others = gusts;
  others.test.over_place = -2.5 - options.clear_odds;
  EXPECT_FALSE(IsGusty(others, options));
  others = gusts;
  others.test.peakedness_p = 0.8 * std::exp(-options.clear_odds);
  EXPECT_TRUE(IsGusty(others, options));
  others.test.peakedness_p = std::exp(-2.5 - options.clear_odds);
  EXPECT_FALSE(IsGusty(others, options));
  others = gusts;
  others.functions = 21.0;
  EXPECT_FALSE(IsGusty(others, options));
}

// Half sines of 0.8 s every 3.7 s, to all sides.
/// What a second sensor measures where the first shows the force of gusts.
/// @param share of that force it feels @param noise of each sample [N]
SecondSensorShare Again(double share, double noise) {
  const ThinnedFlight flight(Eight(3.0), BlockSplit());
  Gaussian random(11, 0);
  const std::vector<Vector3d> force = Wander(flight.size(), 0.1, 1.5, &random);
  Eigen::MatrixX2d foreseen(flight.size(), 2), again(flight.size(), 2);
  for (int i = 0; i < flight.size(); ++i) {
    foreseen.row(i) = force[i].head<2>();
    again.row(i) = share * force[i].head<2>() + noise * random.Next3().head<2>() +
                   Eigen::Vector2d(0.3, -0.2);  // its bias
  }
  return ShareInSecondSensor(flight, foreseen, again).value();
}

TEST(SecondSensorShare, ASecondSensorTellsAirFromAnErrorOfTheFirst) {
  const SecondSensorShare air = Again(1.0, 0.3), error = Again(0.0, 0.3), half = Again(0.5, 0.3);
  EXPECT_NEAR(air.share, 1.0, 3.0 * air.sigma);
  EXPECT_NEAR(error.share, 0.0, 3.0 * error.sigma);
  EXPECT_LT(air.sigma, 0.15);
  EXPECT_GT(air.ActingShare(), 0.9);
  EXPECT_LT(error.ActingShare(), 0.2);
  EXPECT_NEAR(half.ActingShare(), 0.5, 3.0 * half.sigma);
  // Noise that hides them says nothing: the mean of the prior.
  EXPECT_NEAR(Again(1.0, 30.0).ActingShare(), 0.75, 0.03);
  EXPECT_NEAR(Again(0.0, 30.0).ActingShare(), 0.75, 0.03);
}

TEST(SecondSensorShare, TheActingShareIsBayesRule) {
  for (const double share : {-0.3, 0.0, 0.2, 0.5, 0.9, 1.0, 1.4}) {
    for (const double sigma : {0.05, 0.2, 1.0}) {
      const auto likelihood = [&](double s) {
        return std::exp(-0.5 * std::pow((share - s) / sigma, 2));
      };
      double evidence = likelihood(1.0), mean = likelihood(1.0);
      constexpr int kSteps = 20000;
      for (int i = 0; i < kSteps; ++i) {
        const double s = (i + 0.5) / kSteps;
        evidence += likelihood(s) / kSteps;
        mean += s * likelihood(s) / kSteps;
      }
      EXPECT_NEAR((SecondSensorShare{share, sigma}.ActingShare()), mean / evidence, 1e-6)
          << share << " +- " << sigma;
    }
  }
  EXPECT_EQ((SecondSensorShare{-3.0, 0.01}.ActingShare()), 0.0);
  EXPECT_EQ((SecondSensorShare{4.0, 0.01}.ActingShare()), 1.0);
}

TEST(SecondSensorShare, NothingWithoutASecondSensorOrBlocks) {
  const ThinnedFlight flight(Eight(3.0), BlockSplit());
  EXPECT_FALSE(ShareInSecondSensor(flight, Eigen::MatrixX2d::Ones(flight.size(), 2),
                                   Eigen::MatrixX2d(0, 2)));
  EXPECT_FALSE(ShareInSecondSensor(flight, Eigen::MatrixX2d::Zero(flight.size(), 2),
                                   Eigen::MatrixX2d::Ones(flight.size(), 2)));
  BlockSplit long_blocks;
  long_blocks.block_s = 10.0;  // three of them
  const ThinnedFlight few(Eight(3.0), long_blocks);
  const Eigen::MatrixX2d force = Eigen::MatrixX2d::Random(few.size(), 2);
  EXPECT_FALSE(ShareInSecondSensor(few, force, force));
  EXPECT_TRUE(
      ShareInSecondSensor(flight, force.topRows(flight.size()), force.topRows(flight.size())));
}

TEST(GustTest, KnocksArePeaked) {
  std::vector<Vector3d> knocks;
  Gaussian random(6, 0);
  Vector3d direction = random.Next3().normalized();
  for (int i = 0; i < kSamples; ++i) {
    const double at_s = std::fmod(i * ThinnedFlight::kStep_s, 3.7);
    if (at_s < ThinnedFlight::kStep_s) direction = random.Next3().normalized();
    knocks.push_back(at_s < 0.8 ? Vector3d(std::sin(at_s / 0.8 * EIGEN_PI) * direction)
                                : Vector3d(Vector3d::Zero()));
  }
  EXPECT_LT(Case(0.2, kTrueDrag, kTrueDrag, kNothing, knocks).Test().peakedness_p, 1e-9);
  for (int seed = 3; seed < 9; ++seed) {
    EXPECT_GT(Windy(3.0, kWrongDrag, seed).Test().peakedness_p, 0.01) << seed;
  }
}

TEST(GustTest, PredictsNothingOfNoFlight) {
  const ThinnedFlight none(FlightMotion{}, BlockSplit{});
  EXPECT_TRUE(PredictGusts(none, ResidualModel::Wrenches::Zero(0, kNumChannels), {},
                           Vector3d::Ones(), 1.0, 4)
                  .empty());
}

TEST(GustTest, DoesNotLookAtBlocksHeldOut) {
  Case windy = Windy(3.0, kWrongDrag);
  const GustTest before = windy.Test();
  int held_out = 0;
  for (int i = 0; i < windy.flight.size(); ++i) {
    if (!windy.flight.held_out(i)) continue;
    windy.residual.row(i).setConstant(100.0);
    ++held_out;
  }
  ASSERT_GT(held_out, 100);
  const GustTest after = windy.Test();
  EXPECT_EQ(after.gain, before.gain);
  EXPECT_EQ(after.over_others, before.over_others);
}

}  // namespace
}  // namespace odmc
