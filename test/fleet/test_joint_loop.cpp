// Closing the loop on several flights of one vehicle.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "odmc/fleet/joint_loop.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/fading_thrust.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace test {
namespace {

constexpr const char* kHubMoment = "hub_moment.k_beta";

/// Flights of one vehicle that exist in memory only, by name.
class Hangar {
 public:
  /// Flies `effect` with one value of each flight (0: without), along other trajectories each.
  Hangar(const std::string& parameter, const std::vector<double>& values) {
    const std::string effect = parameter.substr(0, parameter.find('.'));
    const std::vector<std::string> trajectories = {"octo", "lemniscate", "aggressive"};
    for (size_t i = 0; i < values.size(); ++i) {
      Vehicle flown = vehicle();
      flown.effects.push_back(effect);
      const DynamicModel model(flown, flown.effects);
      ModelValues truth = DefaultTruth(model);
      truth[model.IndexOf(parameter)] = values[i];
      SimulationOptions options;
      options.trajectory = trajectories[i % trajectories.size()];
      options.duration_s = 12.0;
      options.log_rate_hz = 100.0;
      options.seed = 40 + static_cast<int>(i);
      SimulationNoise noise;
      noise.imu = true;
      const std::string name = "flight" + std::to_string(i);
      logs_[name] = Simulate(model, truth, options, noise).log;
      logs_[name].file = name;
      files.push_back(name);
    }
  }

  static Vehicle vehicle() {
    Vehicle vehicle = NominalVehicle();
    vehicle.imu = SensorMount();
    return vehicle;
  }

  JointLoop Close(const std::vector<std::string>& held_out = {}) const {
    JointLoopOptions options;
    options.calibration.estimator.keyframe_rate_hz = 50.0;
    options.calibration.doubted_flights = 1;
    options.calibration.jobs = 2;
    std::vector<std::string> learned;
    for (const std::string& file : files) {
      if (std::count(held_out.begin(), held_out.end(), file) == 0) learned.push_back(file);
    }
    const FlightSource source = [this](const std::string& file) {
      return InspectedFlight{logs_.at(file), {}};
    };
    return CloseLoopOnSeveral(learned, held_out, source, vehicle(), vehicle(), options);
  }

  std::vector<std::string> files;

 private:
  std::map<std::string, FlightLog> logs_;
};

bool Names(const JointEffect& joint, const std::string& name) {
  const std::vector<std::string>& others = joint.effect.alternatives;
  return joint.effect.name == name || std::count(others.begin(), others.end(), name) > 0;
}

/// A hub moment, the same about both axes or not.
bool IsHubMoment(const JointEffect& joint) {
  return Names(joint, "hub_moment") || Names(joint, "anisotropic_hub_moment");
}

std::string All(const JointLoop& loop) { return JointLoopTable(loop); }

// An undeclared hub moment, the same on every flight.
TEST(JointLoop, NamesWhatTheVehicleLacksByTheEvidenceOfAllFlights) {
  const double truth = 2e-6;
  const Hangar hangar(kHubMoment, {truth, truth, truth, truth});
  const JointLoop loop = hangar.Close({"flight3"});
  ASSERT_EQ(loop.verdict, Verdict::kEffect) << All(loop);
  ASSERT_EQ(loop.effects.size(), 1u) << All(loop);
  const JointEffect& found = loop.effects.front();
  EXPECT_TRUE(IsHubMoment(found)) << All(loop);
  EXPECT_EQ(found.speak_for, 3);
  EXPECT_EQ(found.against, 0);
  // Every flight by itself and all together have it.
  ASSERT_EQ(found.effect.by_flight.size(), 3u);
  ASSERT_FALSE(found.spreads.empty());
  for (const CoefficientSpread& spread : found.spreads) {
    EXPECT_NEAR(spread.mean, truth, 3.0 * spread.sigma) << spread.full_name;
    EXPECT_LT(spread.sigma, 0.1 * truth) << spread.full_name;
    EXPECT_GE(spread.agreeing, 2) << spread.full_name;
  }
  // And a flight that nothing was learned from is predicted better with it.
  ASSERT_EQ(loop.held_out_after.size(), 1u);
  const auto &before = loop.held_out_before.front().left_out.torque_rmse_Nm,
             &after = loop.held_out_after.front().left_out.torque_rmse_Nm;
  ASSERT_TRUE(before && after);
  EXPECT_LT(after->head<2>().norm(), 0.8 * before->head<2>().norm()) << All(loop);
  const auto report = nlohmann::json::parse(
      JointLoopReport(loop, DynamicModel(hangar.vehicle(), loop.effect_names)));
  EXPECT_EQ(report["close_loop"]["effects"][0]["flights_for"], 3);
  EXPECT_EQ(report["close_loop"]["effects"][0]["by_flight"].size(), 3u);
  EXPECT_EQ(report["close_loop"]["held_out"].size(), 1u);
  EXPECT_EQ(report["parameters"]["thrust.k_f"]["sign_unphysical"], false);
  EXPECT_NE(JointLoopCsv(loop).find("flight0," + found.effect.name), std::string::npos);
}

// What odometry shows of a slow effect is not lost behind a noisy accelerometer.
TEST(JointLoop, SeesWhatIsSlowBehindNoisyAccelerometers) {
  const auto gain = [](bool with_accelerometer) {
    std::map<std::string, FlightLog> logs;
    std::vector<std::string> files;
    for (const int seed : {1, 2}) {
      FlightLog log = FlightOfFadingThrust(with_accelerometer, seed, 16.0);
      files.push_back(log.file);
      logs[log.file] = std::move(log);
    }
    JointLoopOptions options;
    options.calibration.estimator.keyframe_rate_hz = 50.0;
    const FlightSource source = [&](const std::string& file) {
      return InspectedFlight{logs.at(file), {}};
    };
    const Vehicle vehicle = VehicleWithImu();
    const JointLoop loop = CloseLoopOnSeveral(files, {}, source, vehicle, vehicle, options);
    return ScoreOfFadingThrust(loop.ranking);
  };
  const double by_motion = gain(false);
  EXPECT_GT(by_motion, 50.0);
  EXPECT_GT(gain(true), 0.5 * by_motion);
}

// The same size, its sign another one from flight to flight: nothing of the vehicle's.
TEST(JointLoop, NamesNoCoefficientThatJumps) {
  const double size = 2e-6;
  const Hangar hangar(kHubMoment, {size, -size, size, -size});
  const JointLoop loop = hangar.Close();
  for (const JointEffect& joint : loop.effects) {
    EXPECT_FALSE(IsHubMoment(joint)) << All(loop);
  }
}

TEST(JointLoop, NamesNothingWhereNothingActs) {
  const Hangar hangar(kHubMoment, {0.0, 0.0, 0.0});
  const JointLoop loop = hangar.Close();
  EXPECT_EQ(loop.verdict, Verdict::kNone) << All(loop);
  EXPECT_TRUE(loop.effects.empty()) << All(loop);
}

// Wind is the flight's: it blows from opposite sides, which one coefficient of both would not show.
TEST(JointLoop, GivesEachFlightItsOwnWind) {
  const Hangar hangar("wind.w_x", {2.0, -2.0});
  const JointLoop loop = hangar.Close();
  const auto wind = std::find_if(loop.effects.begin(), loop.effects.end(),
                                 [](const JointEffect& e) { return Names(e, "wind"); });
  ASSERT_NE(wind, loop.effects.end()) << All(loop);
  EXPECT_EQ(wind->speak_for, 2) << All(loop);
  const double signs[] = {1.0, -1.0};
  for (size_t f = 0; f < 2; ++f) {
    bool has = false;
    for (const ParameterEstimate& p : wind->effect.by_flight[f].parameters) {
      if (p.full_name != "wind.w_x") continue;
      has = true;
      EXPECT_NEAR(p.value, 2.0 * signs[f], std::max(1.0, 3.0 * p.sigma)) << f;
    }
    EXPECT_TRUE(has) << f;
  }
}

/// A calibrated fleet of one flight whose joint estimate has these values.
FleetCalibration FleetWith(const std::vector<std::string>& names, const Eigen::VectorXd& value,
                           const Eigen::VectorXd& sigma) {
  FleetCalibration fleet;
  FleetFlight flight;
  flight.factor.names = names;
  fleet.flights = {flight};
  fleet.joint.value = value;
  fleet.joint.sigma = sigma;
  fleet.joint.covariance = sigma.cwiseAbs2().asDiagonal();
  fleet.joint.fit.scatter = Eigen::VectorXd::Zero(value.size());
  return fleet;
}

RankedEffect Ranked(const std::string& name, double score, const std::vector<std::string>& names,
                    const Eigen::VectorXd& value, const Eigen::VectorXd& sigma) {
  RankedEffect effect;
  effect.name = name;
  effect.score = score;
  for (size_t k = 0; k < names.size(); ++k) {
    ParameterEstimate p;
    p.full_name = names[k];
    p.value = value[static_cast<Eigen::Index>(k)];
    p.estimated = true;
    effect.parameters.push_back(p);
  }
  effect.covariance = sigma.cwiseAbs2().asDiagonal();
  return effect;
}

// Where a load hangs says nothing of whether one does: its mass must differ from zero, and be one.
TEST(JointLoop, NamesNoLoadWithoutMass) {
  const std::vector<std::string> names = {"suspended_load.mass", "suspended_load.z"};
  const AttributionOptions options;
  const auto why = [&](const Eigen::Vector2d& joint, double score) {
    const Eigen::Vector2d sigma(0.006, 0.005);
    return WhyNotTheVehicles(
        Ranked("suspended_load", score, names, Eigen::Vector2d(0.08, 0.05), sigma),
        FleetWith(names, joint, sigma), Hangar::vehicle(), options);
  };
  EXPECT_NE(why({-0.008, 0.05}, 20.0).find("sign"), std::string::npos);
  EXPECT_NE(why({-0.008, 0.05}, 500.0).find("sign"), std::string::npos);
  EXPECT_EQ(why({0.08, 0.05}, 20.0), "");
  const auto chance = [&](double mass) {
    return ChanceOfNoSize(
        "suspended_load",
        FleetWith(names, Eigen::Vector2d(mass, 0.05), Eigen::Vector2d(0.006, 0.005)),
        Hangar::vehicle());
  };
  EXPECT_NEAR(chance(0.006), 0.317, 0.001);  // one sigma
  EXPECT_LT(chance(0.08), 1e-6);
}

// Three flights leave a scatter so uncertain that hardly anything differs from zero, and seems to
// jump. It does where flights contradict each other.
TEST(JointLoop, RefusesWhatJumpsWhereFlightsContradictEachOther) {
  const std::vector<std::string> names = {"odometry_extrinsics.px", "odometry_extrinsics.py"};
  const AttributionOptions options;
  const Eigen::Vector2d joint(-0.017, -0.020), sigma(0.012, 0.016);
  FleetCalibration fleet = FleetWith(names, joint, sigma);
  fleet.joint.fit.scatter = Eigen::Vector2d(0.02, 0.028);
  RankedEffect effect = Ranked("odometry_extrinsics", 270.0, names, Eigen::Vector2d(-0.017, -0.033),
                               Eigen::Vector2d(0.001, 0.001));
  const auto says = [](std::initializer_list<double> nats) {
    std::vector<FlightEvidence> flights;
    for (const double n : nats) flights.push_back({n, {}});
    return flights;
  };
  effect.by_flight = says({120.0, 1.0, 150.0});
  EXPECT_EQ(WhyNotTheVehicles(effect, fleet, Hangar::vehicle(), options), "");
  EXPECT_GT(ChanceOfNoSize("odometry_extrinsics", fleet, Hangar::vehicle()), 0.01);
  effect.by_flight = says({180.0, -60.0, 150.0});
  EXPECT_NE(WhyNotTheVehicles(effect, fleet, Hangar::vehicle(), options).find("jumps"),
            std::string::npos);
}

}  // namespace
}  // namespace test
}  // namespace odmc
