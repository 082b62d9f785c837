// Many flights of one vehicle: the linear algebra and the statistics, on made-up factors.

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <random>
#include <stdexcept>

#include "odmc/fleet/fleet_flight_json.h"
#include "odmc/fleet/joint_estimate.h"
#include "odmc/fleet/scalar_history.h"
#include "odmc/fleet/unlike_history.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace test {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr int kParameters = 4;

class Random {
 public:
  explicit Random(unsigned seed) : engine_(seed) {}
  double Normal() { return normal_(engine_); }
  VectorXd Vector(Index n) {
    return VectorXd::NullaryExpr(n, [&] { return Normal(); });
  }
  MatrixXd Matrix(Index n, Index m) {
    return MatrixXd::NullaryExpr(n, m, [&] { return Normal(); });
  }

 private:
  std::mt19937 engine_;
  std::normal_distribution<double> normal_;
};

VectorXd PriorValue() { return VectorXd::LinSpaced(kParameters, 1.0, 4.0); }
VectorXd PriorSigma() { return VectorXd::LinSpaced(kParameters, 0.5, 2.0); }

/// A flight's linear regression: y = A x + B o + noise of 1, with unknowns o of its own.
struct LinearFlight {
  MatrixXd A, B;
  VectorXd y;
};

LinearFlight Fly(const VectorXd& x, Index rows, double gain, Random* random) {
  LinearFlight flight;
  flight.A = gain * random->Matrix(rows, kParameters);
  flight.B = random->Matrix(rows, 2);
  flight.y = flight.A * x + flight.B * random->Vector(2) + random->Vector(rows);
  return flight;
}

/// What an estimator of this flight alone would publish, as a factor. Own unknowns have prior 1.
FlightFactor FactorOfFlight(const LinearFlight& f) {
  const VectorXd inverse = PriorSigma().cwiseInverse().cwiseAbs2();
  MatrixXd H(kParameters + 2, kParameters + 2);
  MatrixXd all(f.A.rows(), kParameters + 2);
  all << f.A, f.B;
  H = all.transpose() * all;
  H.diagonal().head(kParameters) += inverse;
  H.diagonal().tail(2).array() += 1.0;
  VectorXd b = all.transpose() * f.y;
  b.head(kParameters) += inverse.cwiseProduct(PriorValue());
  const MatrixXd covariance = H.inverse();
  FlightFactor factor;
  factor.names = {"a", "b", "c", "d"};
  factor.units = {"", "", "", ""};
  const VectorXd value = (covariance * b).head(kParameters);
  factor.linearized_at = value;
  SetLikelihood(value, covariance.topLeftCorner(kParameters, kParameters),
                VectorXd::Ones(kParameters), PriorValue(), PriorSigma(), &factor);
  return factor;
}

/// Flights whose parameters scatter, all of them well shown unless `gain` is small.
std::vector<FlightFactor> Fleet(int flights, const VectorXd& scatter, double gain, Random* random) {
  std::vector<FlightFactor> factors;
  for (int i = 0; i < flights; ++i) {
    const VectorXd x = PriorValue() + scatter.cwiseProduct(random->Vector(kParameters));
    factors.push_back(FactorOfFlight(Fly(x, 60, gain, random)));
  }
  return factors;
}

TEST(FlightFactor, AnErrorAddsItsSquareToTheCovarianceAndLeavesTheCentre) {
  Random random(5);
  FlightFactor factor = FactorOfFlight(Fly(PriorValue(), 40, 1.0, &random));
  const auto covariance = [&] {
    return MatrixXd((factor.root.transpose() * factor.root).inverse());
  };
  const MatrixXd before = covariance();
  const VectorXd centre = factor.root.inverse() * factor.rhs,
                 error = 0.3 * random.Vector(kParameters);
  AddErrorToFactor(error, &factor);
  EXPECT_LT((covariance() - before - error * error.transpose()).norm(), 1e-9 * before.norm());
  EXPECT_LT((factor.root.inverse() * factor.rhs - centre).norm(), 1e-9 * centre.norm());
  EXPECT_TRUE(factor.root.isUpperTriangular());
}

TEST(FlightFactor, ManyAreOneLongRecording) {
  Random random(1);
  const VectorXd truth = PriorValue() + random.Vector(kParameters);
  // One least-squares problem over all flights, each with unknowns of its own.
  constexpr int kFlights = 5;
  std::vector<FlightFactor> factors;
  MatrixXd H = MatrixXd::Zero(kParameters + 2 * kFlights, kParameters + 2 * kFlights);
  VectorXd b = VectorXd::Zero(H.rows());
  H.diagonal().head(kParameters) = PriorSigma().cwiseInverse().cwiseAbs2();
  b.head(kParameters) = H.diagonal().head(kParameters).cwiseProduct(PriorValue());
  H.diagonal().tail(2 * kFlights).setOnes();
  for (int i = 0; i < kFlights; ++i) {
    LinearFlight flight = Fly(truth, 12, 0.3, &random);
    if (i == 2) flight.A.col(1).setZero();  // shows nothing of one of them
    factors.push_back(FactorOfFlight(flight));
    MatrixXd all = MatrixXd::Zero(flight.A.rows(), H.rows());
    all.leftCols(kParameters) = flight.A;
    all.middleCols(kParameters + 2 * i, 2) = flight.B;
    H += all.transpose() * all;
    b += all.transpose() * flight.y;
  }
  const MatrixXd covariance = H.inverse();
  const VectorXd no_scatter = VectorXd::Zero(kParameters);
  const RandomEffects fit = FitRandomEffects(factors, {}, &no_scatter);
  EXPECT_LT((fit.beta - (covariance * b).head(kParameters)).norm(), 1e-9);
  EXPECT_LT((fit.covariance - covariance.topLeftCorner(kParameters, kParameters)).norm(), 1e-9);
}

TEST(FlightFactor, HoldsNothingOfWhatAFlightDoesNotShow) {
  Random random(2);
  LinearFlight flight = Fly(PriorValue(), 40, 1.0, &random);
  flight.A.col(3).setZero();
  const FlightFactor factor = FactorOfFlight(flight);
  EXPECT_LT(factor.root.col(3).norm(), 1e-6);
  EXPECT_TRUE(factor.rhs.allFinite());
}

TEST(FlightFactor, InflationWidensWithoutMoving) {
  FlightFactor plain, wide;
  const VectorXd value = PriorValue() + 0.3 * PriorSigma();
  const MatrixXd covariance = (0.01 * PriorSigma().cwiseAbs2()).asDiagonal();
  SetLikelihood(value, covariance, VectorXd::Ones(kParameters), PriorValue(), PriorSigma(), &plain);
  SetLikelihood(value, covariance, VectorXd::Constant(kParameters, 3.0), PriorValue(), PriorSigma(),
                &wide);
  const auto centre = [](const FlightFactor& f) {
    return VectorXd(f.root.colPivHouseholderQr().solve(f.rhs));
  };
  EXPECT_LT((centre(plain) - centre(wide)).norm(), 1e-9);
  // 0.99 of the variance is the flight's, and all that makes it nine times as large.
  EXPECT_NEAR(plain.root.norm() / wide.root.norm(), std::sqrt((9.0 - 0.01) / 0.99), 1e-9);
}

// Two flights know a + b well, and hardly either of them. What they say of it together lies
// between what each says, however much worse than b a is known.
TEST(FlightFactor, InflationLeavesWhatIsKnownOfASum) {
  const VectorXd prior_value = VectorXd::Zero(2), prior_sigma = VectorXd::Ones(2);
  VectorXd along(2), across(2), inflation(2);
  along << 1.0, 1.0;
  across << 1.0, -1.0;
  inflation << 20.0, 1.0;
  const MatrixXd covariance =
      0.5 * (1e-6 * along * along.transpose() + 0.5 * across * across.transpose());
  std::vector<FlightFactor> factors(2);
  const double sums[] = {0.10, 0.12}, differences[] = {0.8, -0.6};
  for (size_t i = 0; i < 2; ++i) {
    factors[i].names = {"a", "b"};
    SetLikelihood(0.5 * (sums[i] * along + differences[i] * across), covariance, inflation,
                  prior_value, prior_sigma, &factors[i]);
  }
  const VectorXd no_scatter = VectorXd::Zero(2);
  const RandomEffects fit = FitRandomEffects(factors, {}, &no_scatter);
  EXPECT_NEAR(fit.beta.sum(), 0.11, 1e-3);
}

TEST(FlightFactor, RefusesACovarianceThatIsNone) {
  FlightFactor factor;
  factor.flight = "day1.bag";
  MatrixXd covariance = MatrixXd::Identity(kParameters, kParameters);
  covariance(0, 0) = -1.0;
  try {
    SetLikelihood(PriorValue(), covariance, VectorXd::Ones(kParameters), PriorValue(), PriorSigma(),
                  &factor);
    FAIL() << "no error";
  } catch (const std::invalid_argument& e) {
    EXPECT_NE(std::string(e.what()).find("day1.bag"), std::string::npos);
  }
}

TEST(FleetFlight, ReadsBackBitByBit) {
  Random random(3);
  FleetFlight flight;
  flight.file = "/flights/day 1.bag";
  flight.factor = FactorOfFlight(Fly(PriorValue(), 40, 1.0, &random));
  flight.factor.flight = flight.file;
  flight.factor.start_s = 1.7e9 + 0.1;
  flight.factor.estimate.effects = {"thrust"};
  flight.own_fit.force_rmse_N.emplace(0.1, 0.2, 1.0 / 3.0);
  const FleetFlight back = ParseFleetFlight(FormatFleetFlight(flight), "flight.json");
  EXPECT_EQ(back.file, flight.file);
  EXPECT_EQ(back.factor.root, flight.factor.root);
  EXPECT_EQ(back.factor.rhs, flight.factor.rhs);
  EXPECT_EQ(back.factor.start_s, flight.factor.start_s);
  const Eigen::Vector3d none = Eigen::Vector3d::Zero();
  EXPECT_EQ(back.own_fit.force_rmse_N.value_or(none), flight.own_fit.force_rmse_N.value_or(none));
  EXPECT_FALSE(back.own_fit.torque_rmse_Nm);
}

TEST(FleetFlight, SaysWhatIsWrongWithAFile) {
  for (const std::string text : {"", "{}", "{\"file\": 3}", "[1, 2"}) {
    try {
      ParseFleetFlight(text, "x/flight.json");
      FAIL() << text;
    } catch (const std::invalid_argument& e) {
      EXPECT_EQ(std::string(e.what()).find("x/flight.json: "), 0u) << e.what();
    }
  }
}

TEST(RandomEffects, FindsTheScatterBetweenFlights) {
  Random random(4);
  const VectorXd truth = Eigen::Vector4d(0.5, 0.05, 0.0, 0.2);
  VectorXd sum = VectorXd::Zero(kParameters);
  constexpr int kFleets = 20;
  for (int fleet = 0; fleet < kFleets; ++fleet) {
    const RandomEffects fit = FitRandomEffects(Fleet(40, truth, 3.0, &random), {});
    sum += fit.scatter.cwiseAbs2();
  }
  const VectorXd found = (sum / kFleets).cwiseSqrt();
  EXPECT_NEAR(found[0], 0.5, 0.05);
  EXPECT_NEAR(found[1], 0.05, 0.01);
  EXPECT_LT(found[2], 0.02);  // far below a flight's own noise of 0.05
  EXPECT_NEAR(found[3], 0.2, 0.02);
}

// The sigmas hold the truth as often as they say, with few flights, too.
TEST(RandomEffects, ThreeSigmaHoldTheVehicleAndTheNextFlight) {
  Random random(5);
  const VectorXd scatter = VectorXd::Constant(kParameters, 0.3);
  for (const int flights : {3, 5, 30}) {
    int vehicle = 0, next = 0, all = 0;
    for (int fleet = 0; fleet < 300; ++fleet) {
      const JointEstimate joint = EstimateJointly(Fleet(flights, scatter, 2.0, &random));
      const VectorXd drawn = PriorValue() + scatter.cwiseProduct(random.Vector(kParameters));
      for (int k = 0; k < kParameters; ++k, ++all) {
        vehicle += std::abs(joint.value[k] - PriorValue()[k]) < 3.0 * joint.sigma[k];
        next += std::abs(joint.value[k] - drawn[k]) < 3.0 * joint.new_flight_sigma[k];
      }
    }
    EXPECT_GT(vehicle, 0.985 * all) << flights << " flights";
    EXPECT_GT(next, 0.97 * all) << flights << " flights";
    if (flights == 30) {
      EXPECT_LT(next, all) << "of no use";
    }
  }
}

TEST(JointEstimate, SaysNothingOfAHistoryWithoutNews) {
  Random random(6);
  int alarms = 0;
  constexpr int kFleets = 200;
  for (int fleet = 0; fleet < kFleets; ++fleet) {
    const JointEstimate joint =
        EstimateJointly(Fleet(12, VectorXd::Constant(kParameters, 0.3), 2.0, &random));
    alarms += !joint.changes.empty() || !joint.outliers.empty();
  }
  EXPECT_LE(alarms, 20);  // 5 % stated: 10 expected, more than 20 in 1 of 800
}

TEST(JointEstimate, DatesAStepAndNamesOutliers) {
  Random random(7);
  const VectorXd scatter = VectorXd::Constant(kParameters, 0.1);
  int dated = 0, named = 0, covered = 0;
  constexpr int kFleets = 40;
  for (int fleet = 0; fleet < kFleets; ++fleet) {
    std::vector<FlightFactor> factors;
    for (int i = 0; i < 50; ++i) {
      VectorXd x = PriorValue() + scatter.cwiseProduct(random.Vector(kParameters));
      if (i >= 30) x[0] += 0.3;
      if (i == 11) x[2] += 1.0;
      if (i == 40) x[0] -= 0.8;
      factors.push_back(FactorOfFlight(Fly(x, 60, 2.0, &random)));
    }
    const JointEstimate joint = EstimateJointly(factors);
    dated += std::any_of(joint.changes.begin(), joint.changes.end(), [](const VehicleChange& c) {
      return c.kind == VehicleChange::Kind::kStep && c.parameter == 0 &&
             std::abs(c.from - 30) <= 2 && std::abs(c.size - 0.3) < 3.0 * c.sigma + 0.03;
    });
    const auto has = [&](int flight, int parameter) {
      return std::any_of(joint.outliers.begin(), joint.outliers.end(), [&](const auto& o) {
        return o.flight == flight && o.parameter == parameter;
      });
    };
    named += has(11, 2) && has(40, 0);
    covered += std::abs(joint.value[0] - PriorValue()[0] - 0.3) < 3.0 * joint.sigma[0];
  }
  EXPECT_GE(dated, 38);
  EXPECT_GE(named, 38);
  EXPECT_GE(covered, 38);
}

TEST(JointEstimate, TellsWearFromAStep) {
  Random random(8);
  int trends = 0, steps = 0;
  for (int fleet = 0; fleet < 20; ++fleet) {
    std::vector<FlightFactor> factors;
    for (int i = 0; i < 40; ++i) {
      VectorXd x = PriorValue() + 0.05 * random.Vector(kParameters);
      x[1] -= 0.6 * i / 39.0;
      factors.push_back(FactorOfFlight(Fly(x, 60, 2.0, &random)));
    }
    JointOptions options;
    options.false_alarm_rate = 0.01;
    const JointEstimate joint = EstimateJointly(factors, options);
    for (const VehicleChange& c : joint.changes) {
      (c.kind == VehicleChange::Kind::kTrend ? trends : steps) += 1;
      if (c.kind == VehicleChange::Kind::kTrend) {
        EXPECT_NEAR(c.size, -0.6, 4.0 * c.sigma);
      }
    }
  }
  EXPECT_GE(trends, 19);
  EXPECT_LE(steps, 1);
}

// Half of the rate is for what people change between flights: a step of that is told by a p-value
// that is smaller by the ratio, and fleets without news raise no more alarms.
TEST(JointEstimate, LooksFirstForWhatPeopleChange) {
  Random random(21);
  std::vector<FlightFactor> factors;
  for (int i = 0; i < 12; ++i) {
    VectorXd x = PriorValue() + 0.05 * random.Vector(kParameters);
    if (i >= 6) x[0] += 0.4;
    factors.push_back(FactorOfFlight(Fly(x, 60, 2.0, &random)));
  }
  JointOptions options;
  const JointEstimate plain = EstimateJointly(factors, options);
  options.often_changed = {factors.front().names[0]};
  const JointEstimate weighted = EstimateJointly(factors, options);
  ASSERT_EQ(plain.changes.size(), 1u);
  ASSERT_EQ(weighted.changes.size(), 1u);
  EXPECT_NEAR(weighted.changes[0].p_value / plain.changes[0].p_value, 2.0 / kParameters, 1e-9);
  int alarms = 0;
  for (int fleet = 0; fleet < 60; ++fleet) {
    std::vector<FlightFactor> none;
    for (int i = 0; i < 10; ++i) {
      none.push_back(
          FactorOfFlight(Fly(PriorValue() + 0.05 * random.Vector(kParameters), 60, 2.0, &random)));
    }
    const JointEstimate joint = EstimateJointly(none, options);
    alarms += !joint.changes.empty() || !joint.outliers.empty();
  }
  EXPECT_LE(alarms, 9);  // 3 at 5 %; 10 or more in 1 of 1,000
}

// The stated rate holds with few and with many flights, with a scatter far above the flights' noise
// (where the t test is exact) and far below.
TEST(ScalarHistory, KeepsItsRateOfFalseAlarms) {
  Random random(11);
  constexpr int kHistories = 300;
  for (const double noise : {0.3, 3.0}) {
    for (const int flights : {5, 8, 12, 20}) {
      int alarms = 0;
      for (int i = 0; i < kHistories; ++i) {
        ScalarHistory history;
        for (int k = 0; k < flights; ++k) {
          history.time.push_back(k);
          history.value.push_back(random.Normal() + noise * random.Normal());
          history.sigma.push_back(noise);
        }
        alarms += !ExamineHistory(history, 0.05).findings.empty();
      }
      EXPECT_LE(alarms, 27) << flights << " flights, noise " << noise;  // 15; 28 in 1 of 500
    }
  }
}

// Two of nine, the first ones, and well apart: 4 % where the others agree to 0.5 %.
TEST(ScalarHistory, SetsTwoOfNineApart) {
  ScalarHistory history;
  for (const double v : {0.96, 0.963, 1.0, 1.004, 0.997, 1.001, 0.995, 1.003, 1.0}) {
    history.time.push_back(static_cast<double>(history.value.size()));
    history.value.push_back(v);
    history.sigma.push_back(0.001);
  }
  const HistoryFit fit = ExamineHistory(history, 0.001);
  ASSERT_EQ(fit.findings.size(), 1u);
  EXPECT_EQ(fit.findings[0].kind, HistoryFinding::Kind::kStep);
  EXPECT_EQ(fit.findings[0].flight, 2);
}

// The estimator's posterior of a flight that the history was the prior of.
TEST(UnlikeHistory, NamesAVehicleThatIsAnotherAndFewThatAreNot) {
  const Vehicle vehicle = NominalVehicle();
  const DynamicModel model(vehicle, vehicle.effects);
  const int k_f = model.IndexOf("thrust.k_f");
  ParameterSet history;
  history.parameters.push_back({"thrust.k_f", "N s^2", 1.5e-6, 2e-9, true, true, 1.5e-8});
  const double expected_sigma = std::hypot(2e-9, 1.5e-8), noise = 1e-8;
  ModelValues values = model.InitialValues();
  Eigen::VectorXd sigma = Eigen::VectorXd::Zero(model.num_parameters());
  const double gain = 1.0 / (1.0 + std::pow(noise / expected_sigma, 2));
  sigma[k_f] = expected_sigma * std::sqrt(1.0 - gain);
  Random random(12);
  int alarms = 0;
  for (int flight = 0; flight < 5000; ++flight) {
    const double seen = expected_sigma * random.Normal() + noise * random.Normal();
    values[k_f] = 1.5e-6 + gain * seen;
    alarms += !CompareWithHistory(history, model, values, sigma, 0.01).empty();
  }
  EXPECT_NEAR(alarms, 50, 25);
  values[k_f] = 1.5e-6 + gain * 8.0 * expected_sigma;
  const std::vector<UnlikeHistory> unlike = CompareWithHistory(history, model, values, sigma);
  ASSERT_EQ(unlike.size(), 1u);
  EXPECT_NE(unlike[0].Sentence("N s^2").find("above what earlier flights"), std::string::npos);
  sigma[k_f] = 0.9 * expected_sigma;  // not shown yet
  EXPECT_TRUE(CompareWithHistory(history, model, values, sigma).empty());
}

/// Flights that say nothing but how the vertical stood in each: gravity.x, in prior sigmas.
std::vector<FlightFactor> Leaning(const DynamicModel& model, const VectorXd& by) {
  ParameterSet set;
  set.effects = model.vehicle().effects;
  for (const ModelParameter& p : model.parameters()) {
    set.parameters.push_back({p.full_name, p.spec.unit, p.spec.prior_value,
                              0.1 * p.spec.prior_sigma, p.estimated, p.estimated});
  }
  VectorXd sigma(model.num_parameters());
  for (Index k = 0; k < sigma.size(); ++k) sigma[k] = set.parameters[static_cast<size_t>(k)].sigma;
  set.covariance = sigma.cwiseAbs2().asDiagonal();
  ParameterEstimate& x = set.parameters[static_cast<size_t>(model.IndexOf("gravity.x"))];
  std::vector<FlightFactor> factors;
  for (const double b : by) {
    x.value = 10.0 * x.sigma * b;
    factors.push_back(FactorOf(model, set, VectorXd::Ones(sigma.size())));
  }
  return factors;
}

TEST(JointEstimate, ForeseesWhatEveryFlightHasOfItsOwn) {
  const Vehicle vehicle = NominalVehicle();
  const DynamicModel model(vehicle, vehicle.effects);
  const double prior =
      model.parameters()[static_cast<size_t>(model.IndexOf("gravity.x"))].spec.prior_sigma;
  Random random(12);
  const auto foreseen = [&](const VectorXd& by) {
    const std::vector<FlightFactor> factors = Leaning(model, by);
    const ParameterSet set = ToParameterSet(EstimateJointly(factors), factors, model);
    return *set.Find("gravity.x");
  };
  // Two flights as the vehicle file expects them: the third is not like their mean.
  constexpr int kFleets = 300;
  double squares = 0.0, of_mean = 0.0;
  int inside = 0;
  for (int fleet = 0; fleet < kFleets; ++fleet) {
    const VectorXd by = random.Vector(2);
    const double next = random.Normal();
    const ParameterEstimate x = foreseen(by);
    squares += std::pow(x.value / prior - next, 2);
    of_mean += std::pow(by.mean() - next, 2);
    inside += std::abs(x.value - prior * next) < 3.0 * x.sigma;
    EXPECT_LE(x.sigma, prior) << "two flights do not make the vehicle file less true";
  }
  EXPECT_LT(squares, 0.9 * of_mean);
  EXPECT_GE(inside, kFleets * 97 / 100);
  // Many that lean alike say more than the file.
  const ParameterEstimate x = foreseen((0.8 + 0.02 * random.Vector(12).array()).matrix());
  EXPECT_NEAR(x.value, 0.8 * prior, 0.03 * prior);
  EXPECT_LT(x.sigma, 0.3 * prior);
}

TEST(RandomEffects, RefusesFlightsOfOtherModels) {
  Random random(9);
  std::vector<FlightFactor> factors = Fleet(2, VectorXd::Zero(kParameters), 1.0, &random);
  factors[1].names[2] = "z";
  factors[1].flight = "other.bag";
  try {
    FitRandomEffects(factors, {});
    FAIL() << "no error";
  } catch (const std::invalid_argument& e) {
    EXPECT_NE(std::string(e.what()).find("other.bag"), std::string::npos);
  }
}

TEST(RandomEffects, ExpectsOfAFlightWhatTheOthersSay) {
  Random random(10);
  std::vector<FlightFactor> factors = Fleet(6, VectorXd::Constant(kParameters, 0.2), 2.0, &random);
  const RandomEffects fit = FitRandomEffects(factors, {});
  const std::vector<VectorXd> expected = ExpectedOfLeftOut(factors, {}, fit);
  for (size_t i = 0; i < factors.size(); ++i) {
    std::vector<FlightFactor> rest = factors;
    rest.erase(rest.begin() + static_cast<long>(i));
    const RandomEffects of_rest = FitRandomEffects(rest, {}, &fit.scatter);
    EXPECT_LT((expected[i] - of_rest.beta).norm(), 1e-8);
  }
}

}  // namespace
}  // namespace test
}  // namespace odmc
