// A node that starts from a fleet's history: how soon it sees another vehicle, and how seldom one
// that is not.

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <map>
#include <random>
#include <string>

#include "odmc/analysis/replay.h"
#include "odmc/fleet/unlike_history.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace test {
namespace {

constexpr double kGround_s = 2.0;

/// How well a fleet knows a parameter, and by how much flights differ.
ParameterEstimate Known(const ModelParameter& p, double value, double scatter) {
  constexpr double kSigmaOverScatter = 0.3, kScatter_m = 5e-4, kTilt_rad = 0.003;
  ParameterEstimate known{p.full_name, p.spec.unit, value, 0.0, p.estimated, true, 0.0};
  if (!p.estimated) return known;
  if (p.effect == "gravity") {
    known.sigma = kTilt_rad;
  } else {
    known.scatter = p.spec.unit == "m" ? kScatter_m : scatter * std::abs(value);
    known.sigma = kSigmaOverScatter * known.scatter;
  }
  return known;
}

/// The history of the nominal vehicle, whose coefficients scatter by a share from flight to flight.
struct Fleet {
  explicit Fleet(double scatter = 0.01)
      : truth_model(vehicle, vehicle.effects), truth(DefaultTruth(truth_model)) {
    history.effects = vehicle.effects;
    for (int k = 0; k < truth_model.num_parameters(); ++k) {
      history.parameters.push_back(Known(truth_model.parameters()[k], truth[k], scatter));
    }
    prior = vehicle;
    ApplyParameters(history, &prior);
  }

  /// Another flight's vehicle.
  ModelValues Draw(int seed) const {
    std::mt19937 engine(static_cast<unsigned>(seed));
    std::normal_distribution<double> normal;
    ModelValues drawn = truth;
    for (int k = 0; k < truth.size(); ++k) {
      const ParameterEstimate& p = history.parameters[static_cast<size_t>(k)];
      drawn[k] += std::hypot(p.sigma, p.scatter) * normal(engine);
    }
    return drawn;
  }

  Vehicle vehicle = NominalVehicle(), prior;
  DynamicModel truth_model;
  ModelValues truth;
  ParameterSet history;
};

/// When something is named first, in seconds after take-off; all that is ever named.
struct Watched {
  std::map<std::string, double> first_s;
};

SimulatedFlight Fly(const Fleet& fleet, const ModelValues& today, const std::string& trajectory,
                    double flown_s, int seed) {
  SimulationOptions options;
  options.trajectory = trajectory;
  options.ground_s = kGround_s;
  options.duration_s = kGround_s + flown_s;
  options.log_rate_hz = 200.0;
  options.seed = seed;
  return Simulate(fleet.truth_model, today, options);
}

Watched Watch(const Fleet& fleet, const FlightLog& log, double rate = 1e-3) {
  const DynamicModel model(fleet.prior, fleet.prior.effects);
  Estimator estimator(&model, OfflineOptions(), true);
  const ReplayResult replay = Replay(log, &estimator);
  HistoryWatch watch(fleet.history);
  Watched watched;
  for (const HistoryRow& row : replay.history) {
    for (const UnlikeHistory& unlike : watch.Look(row.t_s, model, row.values, row.sigma, rate)) {
      watched.first_s.emplace(unlike.full_name, row.t_s - kGround_s);
    }
  }
  return watched;
}

/// A parameter that is another one today, and how long hover may take to show it.
struct Another {
  const char* name;
  double by;      // of the value, or in its unit
  double most_s;  // after take-off
  double scatter = 0.01;
};

TEST(HistoryWatch, SecondsOfHoverShowAnotherVehicle) {
  constexpr int kFlights = 4;
  // With a scatter of 1 %, 4 % are 3.8 standard deviations: at the edge of what a rate of 1e-3
  // allows.
  for (const Another& c : {Another{"thrust.k_f", 0.04, 6.0, 0.005},
                           {"thrust.k_f", -0.04, 6.0, 0.005},
                           {"thrust.k_f", 0.06, 4.5},
                           {"thrust.k_f", -0.06, 4.5},
                           {"thrust.k_f", 0.1, 4.5},
                           {"thrust.k_f", -0.1, 4.5},
                           {"centre_of_gravity.x", 0.003, 4.0},
                           {"centre_of_gravity.y", -0.003, 4.0},
                           {"gravity.x", 0.02, 5.5},
                           {"gravity.y", -0.02, 5.5}}) {
    const Fleet fleet(c.scatter);
    const int k = fleet.truth_model.IndexOf(c.name);
    ASSERT_GE(k, 0) << c.name;
    std::printf("%s off by %+.3f: named after", c.name, c.by);
    for (int seed = 1; seed <= kFlights; ++seed) {
      ModelValues today = fleet.truth;
      const bool is_share = fleet.truth_model.parameters()[k].effect == "thrust";
      today[k] += is_share ? c.by * today[k] : c.by;
      const Watched watched = Watch(fleet, Fly(fleet, today, "hover", 10.0, seed).log);
      const auto named = watched.first_s.find(c.name);
      ASSERT_NE(named, watched.first_s.end()) << c.name << " off by " << c.by << ", seed " << seed;
      EXPECT_LT(named->second, c.most_s) << c.name << " off by " << c.by << ", seed " << seed;
      std::printf(" %.1f", named->second);
    }
    std::printf(" s of hover\n");
  }
}

TEST(HistoryWatch, KeepsItsRateOfFalseAlarms) {
  constexpr int kFlights = 60;
  constexpr double kRate = 0.05;
  const char* trajectories[] = {"hover", "octo", "aggressive", "lemniscate"};
  const Fleet fleet;
  int alarms = 0;
  for (int seed = 1; seed <= kFlights; ++seed) {
    const FlightLog log = Fly(fleet, fleet.Draw(seed), trajectories[seed % 4], 8.0, seed).log;
    alarms += !Watch(fleet, log, kRate).first_s.empty();
  }
  std::printf("%d of %d flights of the same vehicle named at a rate of %g\n", alarms, kFlights,
              kRate);
  // Three sigma of a binomial.
  EXPECT_LE(alarms, kRate * kFlights + 3.0 * std::sqrt(kRate * (1.0 - kRate) * kFlights));
}

TEST(HistoryWatch, NamesWhatLastsAndNotWhatPasses) {
  const Fleet fleet;
  const int k_f = fleet.truth_model.IndexOf("thrust.k_f");
  ModelValues usual = fleet.truth, other = fleet.truth;
  other[k_f] *= 1.1;
  Eigen::VectorXd sigma = Eigen::VectorXd::Zero(usual.size());
  sigma[k_f] = 1e-3 * usual[k_f];
  HistoryWatch watch(fleet.history);
  const auto named = [&](double t_s, const ModelValues& values) {
    return watch.Look(t_s, fleet.truth_model, values, sigma).size();
  };
  EXPECT_EQ(named(1.0, other), 0u);
  EXPECT_EQ(named(2.9, other), 0u);
  EXPECT_EQ(named(2.95, usual), 0u);  // passed
  EXPECT_EQ(named(3.0, other), 0u);
  EXPECT_EQ(named(4.9, other), 0u);
  EXPECT_EQ(named(5.1, other), 1u);
  EXPECT_EQ(named(0.1, other), 0u);  // another flight
  EXPECT_EQ(named(2.2, other), 1u);
}

TEST(UnlikeHistory, SaysInItsUnitWhatLiesAboutZero) {
  const UnlikeHistory tilt{"gravity.x", 0.02, 0.0, 0.003, 1e-6};
  EXPECT_NE(tilt.Sentence("rad").find("0.02 rad above what earlier flights"), std::string::npos);
  const UnlikeHistory thrust{"thrust.k_f", 1.41e-6, 1.5e-6, 1e-8, 1e-6};
  EXPECT_NE(thrust.Sentence("N s^2").find("6 % below what earlier flights"), std::string::npos);
}

}  // namespace
}  // namespace test
}  // namespace odmc
