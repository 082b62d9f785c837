// How effects are told from noise and from what nobody has a name for.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <map>
#include <random>
#include <set>
#include <stdexcept>
#include <string>
#include <vector>

#include "odmc/analysis/flight_motion.h"
#include "odmc/analysis/prediction.h"
#include "odmc/attribution/attribution.h"
#include "odmc/attribution/candidates.h"
#include "odmc/attribution/contained_effects.h"
#include "odmc/attribution/effect_search.h"
#include "odmc/attribution/evidence.h"
#include "odmc/attribution/flexible_features.h"
#include "odmc/attribution/instruments.h"
#include "odmc/attribution/place_field.h"
#include "odmc/bench/undeclared.h"
#include "odmc/estimator/gates.h"
#include "odmc/math/gaussian.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"

namespace odmc {
namespace {

using Eigen::VectorXd;

struct Flown {
  Vehicle vehicle;
  ThinnedFlight flight;
  ParameterSet truth;
};

Flown Filtered(const UndeclaredFlight& flight) {
  const int rotors = flight.declared.num_rotors();
  return {flight.declared, ThinnedFlight(FilterFlight(flight.log, rotors, {}), BlockSplit()),
          flight.truth};
}

/// A flight on which effects make up `share` of the residual, none where there are none.
UndeclaredFlight Make(const std::vector<std::string>& effects, double share,
                      const std::string& trajectory, int vehicle, int seed) {
  UndeclaredPlan plan;
  plan.kind = effects.empty()       ? UndeclaredKind::kNothing
              : effects.size() == 1 ? UndeclaredKind::kOneEffect
                                    : UndeclaredKind::kTwoEffects;
  plan.effects = effects;
  plan.share = share;
  plan.trajectory = trajectory;
  plan.vehicle = vehicle;
  plan.seed = seed;
  return MakeUndeclared(plan);
}

std::vector<std::string> WithEffect(std::vector<std::string> effects, const std::string& effect) {
  effects.push_back(effect);
  return effects;
}

/// The declared model as its file has it.
ModelPoint DeclaredPoint(const Vehicle& vehicle) {
  const DynamicModel model(vehicle, vehicle.effects);
  return ModelPointOf(model, model.InitialValues());
}

/// All of attribution, without an online estimate.
Attribution Attribute(const Flown& flown, const ResidualModel& residual) {
  Attribution attribution(&residual, DeclaredPoint(flown.vehicle),
                          CandidatesFor(flown.vehicle, flown.flight.motion()), {});
  attribution.Run();
  return attribution;
}

bool Has(const std::vector<RankedEffect>& effects, const std::string& name) {
  return std::any_of(effects.begin(), effects.end(), [&](const RankedEffect& e) {
    return e.name == name || std::count(e.alternatives.begin(), e.alternatives.end(), name) > 0;
  });
}

bool IsCandidate(const Flown& flown, const std::string& effect) {
  const std::vector<EffectCandidate> all = CandidatesFor(flown.vehicle, flown.flight.motion());
  return std::any_of(all.begin(), all.end(),
                     [&](const EffectCandidate& c) { return c.effect == effect; });
}

/// The same flight seen by sensors that are turned against the body.
TEST(ResidualModel, IsInTheBodysAxesHoweverTheSensorsAreMounted) {
  Vehicle vehicle = UndeclaredVehicles().front();
  vehicle.odometry.q_BS = Eigen::AngleAxisd(1.57, Eigen::Vector3d(0.6, 0.8, 0.0));
  vehicle.imu = SensorMount();
  vehicle.imu->q_BS = Eigen::AngleAxisd(1.57, Eigen::Vector3d::UnitX());
  const DynamicModel model(vehicle, vehicle.effects);
  ModelValues values = DefaultTruth(model);
  SimulationOptions options;
  options.trajectory = "aggressive";
  options.duration_s = 8.0;
  SimulationNoise noise = SimulationNoise::None();
  noise.imu = true;
  const SimulatedFlight flown = Simulate(model, values, options, noise);
  const ThinnedFlight flight(FilterFlight(flown.log, vehicle.num_rotors(), {}), BlockSplit(),
                             vehicle.odometry.q_BS.toRotationMatrix());
  const ResidualModel residual(&flight, &vehicle, true);
  ASSERT_TRUE(residual.from_accelerometer());
  // A tenth of the thrust is missed, along the rotors' axes.
  values[model.IndexOf("thrust.k_f")] /= 1.1;
  const ResidualModel::Wrenches missed = residual.Residual(model, values);
  const double along = missed.col(2).mean();
  EXPECT_GT(along, 0.05 * vehicle.mass_kg * vehicle.gravity_m_s2);
  EXPECT_LT(missed.leftCols<2>().cwiseAbs().maxCoeff(), 0.02 * along);
  for (int i = 0; i < flight.size(); i += 20) {
    const Eigen::Vector3d up = flight.R_WB(i).transpose() * Eigen::Vector3d::UnitZ();
    EXPECT_GT(up.z(), 0.2) << flight.sample(i).t_s;
    EXPECT_NEAR((flight.w_B(i) - vehicle.odometry.q_BS * flight.sample(i).w_S).norm(), 0.0, 1e-12);
  }
}

/// Of means over two seconds, in which an error of many samples shows.
double SlowScatter(const Eigen::VectorXd& x) {
  constexpr Eigen::Index kBlock = 50;
  const Eigen::Index n = x.size() / kBlock;
  Eigen::VectorXd means(n);
  for (Eigen::Index k = 0; k < n; ++k) means[k] = x.segment(k * kBlock, kBlock).mean();
  return std::sqrt((means.array() - means.mean()).square().mean());
}

double Scatter(const Eigen::VectorXd& x) {
  return std::sqrt((x.array() - x.mean()).square().mean());
}

Vehicle WithImu() {
  Vehicle vehicle = UndeclaredVehicles().front();
  vehicle.imu = SensorMount();
  return vehicle;
}

// Slow force by the motion, quick force by the accelerometer, and only along the rotors' axes.
TEST(ResidualModel, BlendsBothSensors) {
  const Vehicle vehicle = WithImu();
  const DynamicModel model(vehicle, vehicle.effects);
  const ModelValues values = DefaultTruth(model);
  SimulationOptions options;
  options.trajectory = "lemniscate";
  options.duration_s = 40.0;
  SimulationNoise noise = SimulationNoise::None();
  noise.position_m = 0.01;
  noise.velocity_m_s = 0.03;
  noise.imu = true;
  noise.accelerometer_noise_density = 0.05;
  noise.accelerometer_bias = {0.1, 0.1, 0.1};
  const SimulatedFlight flown = Simulate(model, values, options, noise);
  const ThinnedFlight flight(FilterFlight(flown.log, vehicle.num_rotors(), {}), BlockSplit(),
                             vehicle.odometry.q_BS.toRotationMatrix());
  ResidualModel residual(&flight, &vehicle, true);
  const ResidualModel::Wrenches felt = residual.Residual(model, values);
  residual.BlendSensors(model, values);
  const ResidualModel::Wrenches blend = residual.Residual(model, values);
  const Eigen::MatrixX3d by_motion = residual.ForceByMotion(model, values);
  EXPECT_LT(SlowScatter(blend.col(2)), 0.5 * SlowScatter(felt.col(2)));
  EXPECT_LT(Scatter(blend.col(2)), 1.05 * Scatter(felt.col(2)));
  EXPECT_LT(Scatter(blend.col(2)), 0.7 * Scatter(by_motion.col(2)));
  EXPECT_EQ((blend - felt).leftCols<2>().norm(), 0.0);
  EXPECT_LT((blend - felt).rightCols<3>().norm(), 1e-9);  // both know the rates
  EXPECT_LT(residual.felt_share_of_constant(2), 0.2);
  EXPECT_EQ(residual.felt_share_of_constant(0), 1.0);
  // The accelerometer's alone again, whatever the model is.
  ModelValues other = values;
  other[model.IndexOf("thrust.k_f")] *= 0.9;
  const Eigen::VectorXd again =
      residual.AsFelt(residual.Residual(model, other), model, other).col(2);
  const Eigen::VectorXd alone =
      ResidualModel(&flight, &vehicle, true).Residual(model, other).col(2);
  EXPECT_LT(((again.array() - again.mean()) - (alone.array() - alone.mean())).abs().maxCoeff(),
            1e-9);
}

// Where both densities are equal: 2 ln(30 / 2.5) = v^2 (1 / 2.5^2 - 1 / 30^2), v = 5.6 ms.
TEST(Candidates, KnowWhatIsOrdinary) {
  const Vehicle vehicle = UndeclaredVehicles().front();
  const auto is_ordinary = [&](const std::string& name, const std::string& parameter, double value,
                               double sigma) {
    RankedEffect effect;
    effect.name = name;
    effect.parameters = {{name + "." + parameter, "", value, sigma, true, true}};
    return IsOrdinary(vehicle, effect);
  };
  for (const double sign : {-1.0, 1.0}) {
    EXPECT_TRUE(is_ordinary("rotor_delay", "delay", sign * 0.0055, 1e-5));
    EXPECT_FALSE(is_ordinary("rotor_delay", "delay", sign * 0.0057, 1e-5));
    // What is known badly is a larger one more seldom than it is ordinary.
    EXPECT_TRUE(is_ordinary("rotor_delay", "delay", sign * 0.0057, 0.001));
    EXPECT_FALSE(is_ordinary("wind", "w_x", sign * 1e-3, 1e-6));
  }
}

/// A flight with an IMU that is mounted otherwise than the vehicle file says.
/// @param rate_noise of the odometry [rad/s], @param gyro_density [rad/s/sqrt(Hz)]
SimulatedFlight WithTurnedGyro(const DynamicModel& model, const Eigen::Quaterniond& q_turn,
                               double rate_noise, double gyro_density) {
  SimulationOptions options;
  options.trajectory = "aggressive";
  options.duration_s = 30.0;
  SimulationNoise noise = SimulationNoise::None();
  noise.rate_rad_s = rate_noise;
  noise.imu = true;
  noise.gyro_noise_density = gyro_density;
  SimulatedFlight flown = Simulate(model, DefaultTruth(model), options, noise);
  for (ImuSample& sample : flown.log.imu) *sample.gyro_I = q_turn * *sample.gyro_I;
  return flown;
}

// Whichever measures the rates better gives the torque, and a mount two degrees off is found.
TEST(ResidualModel, BlendsGyroAndRatesOfTheOdometry) {
  const Vehicle vehicle = WithImu();
  const DynamicModel model(vehicle, vehicle.effects);
  const ModelValues values = DefaultTruth(model);
  const Eigen::Quaterniond q_turn(
      Eigen::AngleAxisd(0.035, Eigen::Vector3d(1.0, -1.0, 1.0).normalized()));
  for (const auto& [rate_noise, gyro_density] :
       {std::pair<double, double>{0.03, 1e-4}, {1e-3, 2e-3}}) {
    const SimulatedFlight flown = WithTurnedGyro(model, q_turn, rate_noise, gyro_density);
    const ThinnedFlight flight(FilterFlight(flown.log, vehicle.num_rotors(), {}), BlockSplit(),
                               vehicle.odometry.q_BS.toRotationMatrix());
    ResidualModel residual(&flight, &vehicle, true);
    EXPECT_TRUE(residual.from_gyro());
    const ResidualModel::Wrenches by_rates = residual.Residual(model, values);
    residual.BlendSensors(model, values);
    const ResidualModel::Wrenches blend = residual.Residual(model, values);
    const bool gyro_is_better = rate_noise > 0.01;
    for (Eigen::Index c = 3; c < kNumChannels; ++c) {
      EXPECT_TRUE(residual.is_blend(static_cast<int>(c)));
      const double left = Scatter(blend.col(c)) / Scatter(by_rates.col(c));
      EXPECT_LT(left, gyro_is_better ? 0.3 : 1.02) << c << " " << gyro_density;
    }
    const Eigen::Matrix3d apart =
        residual.GyroInOdometry() * vehicle.imu->q_BS.toRotationMatrix().transpose() *
        vehicle.odometry.q_BS.toRotationMatrix() * q_turn.toRotationMatrix();
    EXPECT_LT(Eigen::AngleAxisd(apart).angle(), 0.005) << gyro_density;
    // A mount that is fitted leaves no more than one that was known.
    const SimulatedFlight straight =
        WithTurnedGyro(model, Eigen::Quaterniond::Identity(), rate_noise, gyro_density);
    const ThinnedFlight known(FilterFlight(straight.log, vehicle.num_rotors(), {}), BlockSplit(),
                              vehicle.odometry.q_BS.toRotationMatrix());
    ResidualModel of_known(&known, &vehicle, true);
    of_known.BlendSensors(model, values);
    const ResidualModel::Wrenches least = of_known.Residual(model, values);
    for (Eigen::Index c = 3; c < kNumChannels; ++c) {
      EXPECT_LT(Scatter(blend.col(c)), 1.1 * Scatter(least.col(c))) << c << " " << gyro_density;
    }
  }
}

// Noise above half the rate of the samples does not come back as slow noise.
TEST(ThinnedFlight, TakesMeans) {
  FlightMotion motion;
  motion.step_s = 0.01;
  for (int i = 0; i < 6000; ++i) {
    motion.samples.emplace_back();
    FilteredMotion& sample = motion.samples.back();
    sample.t_s = i * motion.step_s;
    sample.follows = i > 0 && i != 3002;
    sample.R_WS.setIdentity();
    sample.a_WS.x() = std::sin(2.0 * M_PI * 24.0 * sample.t_s);  // seen at 25 Hz: 1 Hz
    sample.specific_force_I = sample.a_WS;
    sample.gyro = {sample.a_WS, sample.a_WS};
  }
  const ThinnedFlight mean(motion, BlockSplit());
  const ThinnedFlight pick(motion, BlockSplit(), Eigen::Matrix3d::Identity(), 0.0, Thinning::kPick);
  double of_mean = 0.0, of_pick = 0.0;
  int gaps = 0;
  for (int i = 0; i < mean.size(); ++i) {
    of_mean = std::max(of_mean, std::abs(mean.sample(i).a_WS.x()));
    EXPECT_EQ(mean.sample(i).specific_force_I->x(), mean.sample(i).a_WS.x());
    EXPECT_EQ(mean.sample(i).gyro->w_dot_I.x(), mean.sample(i).a_WS.x());
    EXPECT_NEAR(mean.sample(i).t_s, motion.samples[mean.index(i)].t_s, 0.006);
    if (i == 0) continue;
    gaps += mean.next(i) ? 0 : 1;
    if (mean.next(i)) {
      EXPECT_NEAR(mean.sample(i).t_s - mean.sample(i - 1).t_s, 0.04, 1e-9);
    }
  }
  for (int i = 0; i < pick.size(); ++i) {
    of_pick = std::max(of_pick, std::abs(pick.sample(i).a_WS.x()));
  }
  EXPECT_EQ(gaps, 1);
  EXPECT_GT(of_pick, 0.9);
  EXPECT_LT(of_mean, 0.1);
  EXPECT_TRUE(mean.takes_means());
  EXPECT_FALSE(pick.takes_means());
  // With a quarter held out 20 s are in use of 27.7 s.
  for (const auto& [samples, is_mean] : {std::pair<size_t, bool>{2700, false}, {2800, true}}) {
    FlightMotion some = motion;
    some.samples.resize(samples);
    EXPECT_EQ(ThinnedFlight(some, BlockSplit()).takes_means(), is_mean) << samples;
  }
}

/// Whether attribution uses the accelerometer across the rotors' axes of a flight on which a force
/// of the world acts that the model lacks, 1 m/s^2 along x at half a hertz.
/// @param density noise of the accelerometer [m/s^2/sqrt(Hz)]
/// @param shown share of that force that the velocity shows, the rest smoothed away on board
bool UsesAccelerometer(double density, double shown, unsigned seed) {
  const Vehicle vehicle = WithImu();
  const DynamicModel model(vehicle, vehicle.effects);
  const ModelValues values = DefaultTruth(model);
  SimulationOptions options;
  options.trajectory = "lemniscate";
  options.duration_s = 40.0;
  SimulationNoise noise = SimulationNoise::None();
  noise.velocity_m_s = 0.005;
  noise.imu = true;
  noise.accelerometer_noise_density = density;
  options.seed = static_cast<int>(seed);
  FlightLog log = Simulate(model, values, options, noise).log;
  constexpr double kTurn_rad_s = 3.14159;
  for (OdometrySample& sample : log.odometry) {
    sample.v_WS->x() -= shown / kTurn_rad_s * std::cos(kTurn_rad_s * ToSeconds(sample.stamp));
  }
  auto pose = log.odometry.begin();
  for (ImuSample& sample : log.imu) {
    while (pose + 1 != log.odometry.end() && pose->stamp < sample.stamp) ++pose;
    *sample.specific_force_I += pose->q_WS.conjugate() * Eigen::Vector3d::UnitX() *
                                std::sin(kTurn_rad_s * ToSeconds(sample.stamp));
  }
  const ThinnedFlight flight(FilterFlight(log, vehicle.num_rotors(), {}), BlockSplit(),
                             vehicle.odometry.q_BS.toRotationMatrix());
  ResidualModel residual(&flight, &vehicle, true);
  residual.BlendSensors(model, values);
  EXPECT_TRUE(residual.from_accelerometer());
  EXPECT_TRUE(residual.is_blend(2));
  const bool felt = !residual.across_by_motion();
  EXPECT_EQ(residual.felt_share_of_constant(0), felt ? 1.0 : 0.0);
  const Eigen::MatrixX3d again = residual.ForceByMotion(model, values);
  EXPECT_EQ(again.leftCols<2>().isZero(0.0), !felt);
  EXPECT_FALSE(again.col(2).isZero(0.0));
  return felt;
}

TEST(ResidualModel, TakesTheMotionAcrossTheAxesWhereVibrationIsAllThatIsFelt) {
  for (unsigned seed = 0; seed < 10; ++seed) {
    EXPECT_TRUE(UsesAccelerometer(0.02, 1.0, seed)) << seed;
    EXPECT_FALSE(UsesAccelerometer(1.0, 1.0, seed)) << seed;
  }
}

TEST(ResidualModel, NeedsTheAccelerometerWhereAnOnboardFilterHidesAForce) {
  for (unsigned seed = 0; seed < 10; ++seed) {
    EXPECT_TRUE(UsesAccelerometer(0.02, 0.3, seed)) << seed;
    EXPECT_TRUE(UsesAccelerometer(0.2, 0.3, seed)) << seed;
  }
}

// A long flight is looked at in stretches that are spread over it, with the same share held out.
TEST(ThinnedFlight, TakesStretchesOfALongFlight) {
  FlightMotion motion;
  motion.step_s = ThinnedFlight::kStep_s;
  for (int i = 0; i < 25 * 600; ++i) {
    motion.samples.emplace_back();
    motion.samples.back().t_s = i * motion.step_s;
    motion.samples.back().follows = i > 0;
  }
  const ThinnedFlight all(motion, BlockSplit()), some(motion, BlockSplit(), {}, 240.0);
  EXPECT_NEAR(all.size() * all.step_s(), 599.0, 0.1);
  EXPECT_NEAR(some.size() * some.step_s(), 240.0, 20.0);
  EXPECT_GT(some.sample(some.size() - 1).t_s, 550.0);
  int runs = 0, held_out = 0;
  for (int i = 0; i < some.size(); ++i) {
    held_out += some.held_out(i) ? 1 : 0;
    if (!some.next(i)) {
      ++runs;
    } else {
      ASSERT_NEAR(some.sample(i).t_s - some.sample(i - 1).t_s, some.step_s(), 1e-9);
    }
  }
  EXPECT_NEAR(runs, 12, 1);
  EXPECT_NEAR(held_out, 0.25 * some.size(), 0.02 * some.size());
  EXPECT_EQ(ThinnedFlight(motion, BlockSplit(), {}, 1e5).size(), all.size());
}

// A hub moment is an anisotropic one with equal coefficients, and not the other way round.
TEST(ContainedEffects, AreThoseThatAnotherOneMakesToo) {
  const Flown flown = Filtered(Make({}, 0.0, "octo", 1, 31));
  const ResidualModel residual(&flown.flight, &flown.vehicle, true);
  const Instruments instruments(flown.flight, flown.vehicle);
  const std::vector<FlightWithInstruments> flights = {{&residual, &instruments}};
  ModelPoint point = DeclaredPoint(flown.vehicle);
  const std::vector<std::string> asked = {"hub_moment", "rotor_gyroscopic", "quadratic_drag"};
  for (const std::string& effect : asked) {
    point.vehicle = VehicleWith(point.vehicle, EffectCandidate{effect, {}, {}});
  }
  point.vehicle = VehicleWith(point.vehicle, EffectCandidate{"anisotropic_hub_moment", {}, {}});
  EXPECT_EQ(ContainedEffects(flights, point, asked, "anisotropic_hub_moment"),
            std::vector<std::string>{"hub_moment"});
  EXPECT_TRUE(ContainedEffects(flights, point, {"anisotropic_hub_moment"}, "hub_moment").empty());
  EXPECT_TRUE(ContainedEffects(flights, point, asked, "thrust").empty());
}

TEST(Candidates, GroundEffectNeedsHeightThatVaries) {
  EXPECT_FALSE(IsCandidate(Filtered(Make({}, 0.0, "circle", 0, 31)), "ground_effect"));
  EXPECT_TRUE(IsCandidate(Filtered(Make({}, 0.0, "vertical", 0, 31)), "ground_effect"));
}

// Near ground that was seen, bank alone tells it; ground that may lie anywhere explains any bank.
TEST(Candidates, GroundEffectAtOneHeightNeedsGroundThatWasSeen) {
  const Vehicle vehicle = UndeclaredVehicles().front();
  FlightMotion flight = Filtered(Make({}, 0.0, "circle", 0, 31)).flight.motion();
  const auto is_asked_for = [&] {
    const std::vector<EffectCandidate> all = CandidatesFor(vehicle, flight);
    return std::any_of(all.begin(), all.end(),
                       [](const EffectCandidate& c) { return c.effect == "ground_effect"; });
  };
  EXPECT_FALSE(is_asked_for());
  flight.stood_z_m = 0.1;
  EXPECT_TRUE(is_asked_for());
}

// More or less mass, above or below: no fit walks from one to another.
TEST(Candidates, AChangeOfMassIsTriedInFourValleysAtEachTime) {
  const Flown flown = Filtered(Make({}, 0.0, "octo", 0, 31));
  std::map<double, std::set<std::string>> valleys;
  std::set<std::string> of_loads;
  for (const EffectCandidate& c : CandidatesFor(flown.vehicle, flown.flight.motion())) {
    if (c.effect == "mass_change") {
      valleys[c.settings.at("mass_change.from")].insert(ValleyNameOf(c));
    }
    if (c.effect == "suspended_load") of_loads.insert(ValleyNameOf(c));
  }
  EXPECT_GT(valleys.size(), 10u);
  for (const auto& [from_s, names] : valleys) EXPECT_EQ(names.size(), 4u) << from_s;
  EXPECT_EQ(of_loads, std::set<std::string>{"suspended_load"});  // lengths are walked through
}

// World frames have their origin anywhere: at sea level, on another floor.
TEST(Candidates, TheGroundIsLookedForBelowTheFlightWhereverThatIs) {
  const Vehicle vehicle = UndeclaredVehicles().front();
  for (const double z : {-300.0, 0.0, 450.0}) {
    FlightMotion flight = Filtered(Make({}, 0.0, "vertical", 0, 31)).flight.motion();
    double lowest = 1e9;
    for (FilteredMotion& m : flight.samples) {
      m.p_WS.z() += z;
      lowest = std::min(lowest, m.p_WS.z());
    }
    int grounds = 0;
    for (const EffectCandidate& c : CandidatesFor(vehicle, flight)) {
      if (c.effect != "ground_effect") continue;
      EXPECT_NEAR(c.start.at("ground_effect.z_0"), lowest, 5.0 * vehicle.rotors[0].radius_m) << z;
      ++grounds;
    }
    EXPECT_GE(grounds, 2);
  }
}

// With the whole mass lost a regressor was not a number, and the search for sets had no end.
TEST(Candidates, AreModelsOfABodyAtTheEndsOfTheirBounds) {
  const Flown flown = Filtered(Make({}, 0.0, "octo", 0, 31));
  int bounded = 0;
  for (const EffectCandidate& candidate : CandidatesFor(flown.vehicle, flown.flight.motion())) {
    const DynamicModel model(flown.vehicle, WithEffect(flown.vehicle.effects, candidate.effect));
    for (const auto& [name, bounds] : candidate.bounds) {
      for (const double bound : {bounds.first, bounds.second}) {
        if (!std::isfinite(bound)) continue;
        ModelValues values = model.InitialValues();
        values[model.IndexOf(name)] = bound;
        const BodyProperties body = model.Properties(values);
        EXPECT_GT(body.mass, 0.05 * flown.vehicle.mass_kg) << name << " " << bound;
        EXPECT_TRUE(body.I_BBcm_B.allFinite() && body.p_BBcm.allFinite()) << name << " " << bound;
        ++bounded;
      }
    }
  }
  EXPECT_GT(bounded, 10);
}

// Its column is not a number; it is no candidate then, and the search ends.
TEST(Attribution, EndsWhereACandidateHasNoValue) {
  const Flown flown = Filtered(Make({}, 0.0, "octo", 0, 31));
  const ResidualModel residual(&flown.flight, &flown.vehicle, true);
  EffectCandidate lost{"mass_change", {{"mass_change.from", 8.0}}, {}};
  lost.start = {{"mass_change.mass", -flown.vehicle.mass_kg}};
  Attribution attribution(&residual, DeclaredPoint(flown.vehicle), {lost}, {});
  attribution.Run();
  EXPECT_TRUE(attribution.effects().empty());
}

class OctoFlight : public ::testing::Test {
 protected:
  static void SetUpTestSuite() { flown_ = new Flown(Filtered(Make({}, 0.0, "octo", 0, 31))); }
  static void TearDownTestSuite() {
    delete flown_;
    flown_ = nullptr;
  }

  /// A column of one channel, by flight time.
  static ResidualModel::Wrenches Column(const std::function<double(double)>& value) {
    ResidualModel::Wrenches column =
        ResidualModel::Wrenches::Zero(flown_->flight.size(), kNumChannels);
    for (int i = 0; i < flown_->flight.size(); ++i)
      column(i, 0) = value(flown_->flight.sample(i).t_s);
    return column;
  }

  /// Share of a column that its instruments foresee.
  static double ForeseenShare(const ResidualModel::Wrenches& column) {
    const Instruments instruments(flown_->flight, flown_->vehicle);
    const ResidualModel::Wrenches foreseen =
        instruments.Foreseen(column, ResidualModel::Wrenches::Zero(column.rows(), kNumChannels));
    double all = 0.0, seen = 0.0;
    for (int i = 0; i < flown_->flight.size(); ++i) {
      if (!instruments.Sees(i)) continue;
      all += column(i, 0) * column(i, 0);
      seen += foreseen(i, 0) * foreseen(i, 0);
    }
    return seen / all;
  }

  static Flown* flown_;
};

Flown* OctoFlight::flown_ = nullptr;

TEST_F(OctoFlight, InstrumentsForeseeAManoeuvreAndNoNoise) {
  EXPECT_GT(ForeseenShare(Column([](double t) { return std::sin(2.0 * t); })), 0.95);
  Gaussian random(3, 1);
  const ResidualModel::Wrenches noise = Column([&](double) { return random.Next(); });
  EXPECT_EQ(ForeseenShare(noise), 0.0);
  // A fiftieth of its power is noise: none of that is foreseen.
  const double share =
      ForeseenShare(noise + Column([](double t) { return std::sqrt(98.0) * std::sin(2.0 * t); }));
  EXPECT_GT(share, 0.6);
  EXPECT_LT(share, 0.985);
}

// The past of a product says little of it where both factors change quickly; the product of what is
// foreseen of both says more.
TEST_F(OctoFlight, InstrumentsForeseeProductsThroughTheLikelyMotion) {
  const Instruments instruments(flown_->flight, flown_->vehicle);
  const auto product = [](const ThinnedFlight& flight) {
    ResidualModel::Wrenches column = ResidualModel::Wrenches::Zero(flight.size(), kNumChannels);
    for (int i = 0; i < flight.size(); ++i) {
      column(i, 0) = flight.w_B(i).x() * flight.sample(i).rotors.speed_squared.sum() *
                     flight.sample(i).v_WS.x();
    }
    return column;
  };
  const ResidualModel::Wrenches column = product(flown_->flight);
  const auto rest = [&](const ResidualModel::Wrenches& likely) {
    const ResidualModel::Wrenches foreseen = instruments.Foreseen(column, likely);
    double sum = 0.0;
    for (int i = 8; i < flown_->flight.size(); ++i)
      sum += std::pow(column(i, 0) - foreseen(i, 0), 2);
    return sum;
  };
  EXPECT_LT(rest(product(instruments.likely_flight())), 0.7 * rest(0.0 * column));
}

// A clock that stepped back, or a start that is later than the window.
TEST(Instruments, HaveAFoldForEveryTime) {
  std::set<int> folds;
  for (double t_s = -100.0; t_s < 100.0; t_s += 0.25) {
    const int fold = Instruments::FoldAt(t_s);
    ASSERT_GE(fold, 0) << t_s;
    ASSERT_LT(fold, Instruments::kFolds) << t_s;
    const int step = Instruments::FoldAt(t_s + 0.25) - fold;
    EXPECT_TRUE(step == 0 || step == 1 || step == 1 - Instruments::kFolds) << t_s;  // in turn
    folds.insert(fold);
  }
  EXPECT_EQ(folds.size(), static_cast<size_t>(Instruments::kFolds));
}

TEST_F(OctoFlight, InstrumentsNeedAPast) {
  const Instruments instruments(flown_->flight, flown_->vehicle);
  for (int i = 0; i < 8; ++i) EXPECT_FALSE(instruments.Sees(i));
  EXPECT_TRUE(instruments.Sees(8));
}

// The likely motion is foreseen from other folds, this one among them. Rows must not learn their
// own noise back from it: of a torque that is noise of rotor speeds nothing is foreseen.
TEST(Instruments, ForeseeNoTorqueThatIsNoiseOfRotorSpeeds) {
  for (const int seed : {71, 72, 73, 74}) {
    const Flown flown = Filtered(Make({}, 0.0, "yaw", 1, seed));
    const Instruments instruments(flown.flight, flown.vehicle);
    const auto rolling = [&](const ThinnedFlight& flight) {
      ResidualModel::Wrenches torque = ResidualModel::Wrenches::Zero(flight.size(), kNumChannels);
      for (int i = 0; i < flight.size(); ++i) {
        torque(i, 3) =
            RotorTorqueDirection(flown.vehicle, flight.sample(i).rotors.speed_squared).x();
      }
      torque.col(3).array() -= torque.col(3).mean();
      return torque;
    };
    const ResidualModel::Wrenches torque = rolling(flown.flight);
    const auto foreseen = instruments.Foreseen(torque, rolling(instruments.likely_flight()));
    EXPECT_LT(foreseen.col(3).squaredNorm(), 0.1 * torque.col(3).squaredNorm()) << seed;
  }
}

// Noise of rotor speeds makes the inertia that fits best a multiple of the true one; seen by what
// was foreseen of torque it is the truth.
TEST(Evidence, FindsInertiaThroughTheNoiseOfRotorSpeeds) {
  for (const char* trajectory : {"octo", "aggressive"}) {
    const Flown flown = Filtered(Make({}, 0.0, trajectory, 0, 31));
    const ResidualModel residual(&flown.flight, &flown.vehicle, true);
    const Attribution attribution = Attribute(flown, residual);
    for (const char* name : {"inertia.x", "inertia.y"}) {
      const double truth = flown.truth.Find(name)->value;
      EXPECT_NEAR(attribution.point().values.at(name), truth, 0.12 * truth)
          << trajectory << " " << name;
    }
  }
}

TEST(Evidence, NamesWhatActsWithItsCoefficient) {
  const UndeclaredFlight flight = Make({"quadratic_drag"}, 0.5, "octo", 1, 12);
  const Flown flown = Filtered(flight);
  const ResidualModel residual(&flown.flight, &flown.vehicle, true);
  const Attribution attribution = Attribute(flown, residual);
  ASSERT_FALSE(attribution.effects().empty());
  const RankedEffect& found = attribution.effects().front();
  EXPECT_EQ(found.name, "quadratic_drag");
  EXPECT_LT(found.p_value, 1e-6);
  const double truth = flown.truth.Find("quadratic_drag.c_q")->value;
  EXPECT_NEAR(found.parameters.front().value, truth, 0.2 * truth);
  EXPECT_GT(attribution.held_out_gain(), 0.0);
}

/// Adds the force of quadratic drag at its true size, so many times.
/// @param in_all blocks, or only in those held out
FlightMotion WithMoreDrag(FlightMotion motion, const Flown& flown, double times, bool in_all) {
  const Vehicle with_effect = VehicleWith(flown.vehicle, EffectCandidate{"quadratic_drag", {}, {}});
  const DynamicModel truth(with_effect, with_effect.effects);
  const DynamicModel declared(flown.vehicle, flown.vehicle.effects);
  ModelValues values = truth.InitialValues(), without = declared.InitialValues();
  for (const ParameterEstimate& p : flown.truth.parameters) {
    if (truth.IndexOf(p.full_name) >= 0) values[truth.IndexOf(p.full_name)] = p.value;
    if (declared.IndexOf(p.full_name) >= 0) without[declared.IndexOf(p.full_name)] = p.value;
  }
  const Eigen::Vector3d hanging(0.0, 0.0, -flown.vehicle.gravity_m_s2);
  for (FilteredMotion& sample : motion.samples) {
    sample.specific_force_I.reset();
    if (!in_all && !BlockSplit().IsHeldOut(sample.t_s)) continue;
    const Eigen::Vector3d force =
        PredictSample(sample, hanging, flown.vehicle, truth, values, false).predicted_force -
        PredictSample(sample, hanging, flown.vehicle, declared, without, false).predicted_force;
    sample.a_WS += times * (sample.R_WS * force) / flown.vehicle.mass_kg;
  }
  return motion;
}

// Every way in which an effect is tried takes some of the noise with it, and the ways together what
// is no effect's.
TEST(Evidence, WaysThatAreSetAsideLeaveTheNoiseAsItIs) {
  const Flown flown = Filtered(Make({}, 0.0, "octo", 0, 31));
  const ResidualModel residual(&flown.flight, &flown.vehicle, true);
  const Instruments instruments(flown.flight, flown.vehicle);
  std::vector<EffectCandidate> ways;
  for (const EffectCandidate& c : CandidatesFor(flown.vehicle, flown.flight.motion())) {
    if (c.effect == "mass_change") ways.push_back(c);
  }
  ASSERT_GT(ways.size(), 20u);
  const auto whitened = [&](size_t count, bool sets_aside) {
    FlightRegression flight(&residual, &instruments, DeclaredPoint(flown.vehicle));
    for (size_t k = 0; k < count; ++k) {
      const auto added = flight.Append(ways[k].effect, flight.ActingColumns(ways[k]));
      if (sets_aside && k > 0) flight.SetAside(added);
    }
    flight.EstimateNoise();
    const Eigen::Index y = flight.num_columns();
    return flight.gram()(y, y);
  };
  const double alone = whitened(1, false);
  EXPECT_NEAR(whitened(20, true), alone, 1e-3 * alone);
  EXPECT_GT(whitened(20, false), 1.02 * alone);
}

// A load is all there from one sample to the next: the past, which does not foresee that, would
// make a slow change of it, and place it later.
TEST(Evidence, AnEffectBeginsAtItsOnsetAndNotLater) {
  const Flown flown = Filtered(Make({}, 0.0, "octo", 0, 31));
  const ResidualModel residual(&flown.flight, &flown.vehicle, true);
  const Instruments instruments(flown.flight, flown.vehicle);
  const FlightRegression flight(&residual, &instruments, DeclaredPoint(flown.vehicle));
  std::vector<EffectCandidate> loads = CandidatesFor(flown.vehicle, flown.flight.motion());
  loads.erase(std::remove_if(loads.begin(), loads.end(),
                             [](const auto& c) { return c.effect != "mass_change"; }),
              loads.end());
  ASSERT_GT(loads.size(), 20u);
  const double from_s = flown.flight.sample(flown.flight.size() / 2).t_s;
  loads.front().settings.at("mass_change.from") = from_s;
  const FlightRegression::Seen seen = flight.ActingColumns(loads.front());
  ASSERT_FALSE(seen.columns.empty());
  const Regressor& mass = seen.columns.front();
  ASSERT_EQ(mass.name, "mass_change.mass");
  const double weight = flown.vehicle.gravity_m_s2;
  int after = 0;
  for (int i = 0; i < flown.flight.size(); ++i) {
    if (!instruments.Sees(i)) continue;
    if (flown.flight.sample(i).t_s < from_s) {
      EXPECT_EQ(mass.foreseen.row(i).norm(), 0.0) << i;
    } else if (++after <= Instruments::kReach) {
      EXPECT_GT(mass.foreseen.row(i).head<3>().norm(), 0.5 * weight) << after;
    }
  }
  EXPECT_GT(after, Instruments::kReach);
}

// What of a strong force the past did not foresee is no noise.
TEST(Evidence, NoiseOfForcesDoesNotGrowWithWhatActs) {
  const UndeclaredFlight made = Make({"quadratic_drag"}, 0.2, "octo", 1, 12);
  Flown flown = Filtered(made);
  const FlightMotion motion = FilterFlight(made.log, flown.vehicle.num_rotors(), {});
  const auto sigma = [&](double times) {
    flown.flight = ThinnedFlight(WithMoreDrag(motion, flown, times, true), BlockSplit());
    const ResidualModel residual(&flown.flight, &flown.vehicle, true);
    const Instruments instruments(flown.flight, flown.vehicle);
    Evidence evidence({{&residual, &instruments}}, DeclaredPoint(flown.vehicle));
    const int drag = evidence.Add({"quadratic_drag", {}, {}});
    evidence.EstimateNoise();
    const EffectFit fit = evidence.Solve({drag});
    const auto last = static_cast<Eigen::Index>(fit.columns.size()) - 1;
    EXPECT_EQ(evidence.column(fit.columns.back()).name, "quadratic_drag.c_q");
    return std::sqrt(fit.covariance(last, last));
  };
  const double as_it_was = sigma(0.0);
  EXPECT_NEAR(sigma(10.0), as_it_was, 0.05 * as_it_was);
}

// Jets of air, magnets: no function of a few places explains all of them, a field does.
TEST(Attribution, FindsAForceThatFollowsThePlace) {
  const UndeclaredFlight made = Make({}, 0.0, "aggressive", 1, 31);
  Flown flown = Filtered(made);
  const FlightMotion as_it_was = FilterFlight(made.log, flown.vehicle.num_rotors(), {});
  const auto look = [&](double size_m_s2) {
    FlightMotion motion = as_it_was;
    for (FilteredMotion& s : motion.samples) {
      s.specific_force_I.reset();
      s.a_WS.x() += size_m_s2 * std::sin(4.0 * s.p_WS.x()) * std::cos(5.0 * s.p_WS.y());
    }
    flown.flight = ThinnedFlight(motion, BlockSplit());
    const ResidualModel residual(&flown.flight, &flown.vehicle, true);
    return Attribute(flown, residual).flexible();
  };
  EXPECT_EQ(look(0.0).nats(), 0.0);
  const FlexibleRest found = look(0.5);
  EXPECT_GT(found.of_force, 3.0 * AttributionOptions().clear_odds);
  EXPECT_EQ(found.first, "a force that follows the place");
}

// A vehicle that hovers is where forces have moved it: its place is their trace, not their cause.
TEST(Evidence, AsksNoHoverWhetherAForceFollowsThePlace) {
  const UndeclaredFlight made = Make({}, 0.0, "yaw", 1, 31);
  Flown flown = Filtered(made);
  const FlightMotion as_it_was = FilterFlight(made.log, flown.vehicle.num_rotors(), {});
  for (const double wander_in_arms : {0.5, 4.0}) {
    FlightMotion motion = as_it_was;
    for (FilteredMotion& s : motion.samples) {
      s.p_WS.x() += wander_in_arms * flown.vehicle.ArmLength() * std::sin(0.5 * s.t_s);
    }
    flown.flight = ThinnedFlight(motion, BlockSplit());
    const ResidualModel residual(&flown.flight, &flown.vehicle, true);
    const Instruments instruments(flown.flight, flown.vehicle);
    Evidence evidence({{&residual, &instruments}}, DeclaredPoint(flown.vehicle));
    evidence.EstimateNoise();
    EXPECT_EQ(evidence.GainOfThePlace({}) == 0.0, wander_in_arms < 1.0) << wander_in_arms;
  }
}

// By a dense normal density of the same.
TEST(PlaceField, GainIsThatOfItsCovariance) {
  constexpr int kSamples = 30;
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  const auto drawn = [&](int rows, int cols) {
    Eigen::MatrixXd m(rows, cols);
    for (Eigen::Index k = 0; k < m.size(); ++k) m.data()[k] = normal(random);
    return m;
  };
  const Eigen::MatrixXd places = drawn(kSamples, 3);
  const Eigen::MatrixXd phi = FieldFeatures(places, places, 0.7);
  const Eigen::VectorXd y = drawn(kSamples, 1);
  const auto log_density = [&](double size) {
    Eigen::MatrixXd K = Eigen::MatrixXd::Identity(kSamples, kSamples);
    for (int i = 0; i < kSamples; ++i) {
      for (int k = 0; k < kSamples; ++k) {
        K(i, k) += size * size *
                   std::exp(-0.5 * (places.row(i) - places.row(k)).squaredNorm() / (0.7 * 0.7));
      }
    }
    const Eigen::LLT<Eigen::MatrixXd> llt(K);
    return -0.5 * y.dot(llt.solve(y)) -
           Eigen::MatrixXd(llt.matrixL()).diagonal().array().log().sum();
  };
  for (const double size : {0.3, 2.0}) {
    EXPECT_NEAR(GainOfRandomCoefficients(phi.transpose() * phi, phi.transpose() * y, {size}),
                log_density(size) - log_density(0.0), 1e-3);
  }
  const double mean = std::log(0.5 * (std::exp(log_density(0.3)) + std::exp(log_density(2.0))));
  EXPECT_NEAR(GainOfRandomCoefficients(phi.transpose() * phi, phi.transpose() * y, {0.3, 2.0}),
              mean - log_density(0.0), 1e-3);
}

// What acts in one part of a flight and the other way round in another is not there.
TEST(Evidence, CountsWhatAnEffectLosesOnBlocksHeldOut) {
  const UndeclaredFlight made = Make({"quadratic_drag"}, 0.2, "octo", 1, 12);
  Flown flown = Filtered(made);
  const FlightMotion motion = FilterFlight(made.log, flown.vehicle.num_rotors(), {});
  for (const double times : {0.0, -12.0}) {
    flown.flight = ThinnedFlight(WithMoreDrag(motion, flown, times, false), BlockSplit());
    const ResidualModel residual(&flown.flight, &flown.vehicle, true);
    const Attribution attribution = Attribute(flown, residual);
    EXPECT_EQ(Has(attribution.effects(), "quadratic_drag"), times == 0.0) << times;
    const auto refused = attribution.refused().find("quadratic_drag");
    const bool for_its_loss = refused != attribution.refused().end() &&
                              refused->second.find("on blocks held out") != std::string::npos;
    EXPECT_EQ(for_its_loss, times < 0.0) << times;
  }
}

// Drag that goes with the rotors' speed is one with the declared drag but for the little that this
// changes, where it has no moment.
TEST(Evidence, TellsRotorDragFromDrag) {
  Vehicle vehicle = UndeclaredVehicles()[1];
  Vehicle true_vehicle = vehicle;
  true_vehicle.effects.emplace_back("rotor_drag");
  const DynamicModel model(true_vehicle, true_vehicle.effects);
  ModelValues truth = DefaultTruth(model);
  const int k_d = model.IndexOf("rotor_drag.k_d");
  truth[k_d] = model.parameters()[k_d].spec.prior_sigma;
  truth[model.IndexOf("rotor_drag.k_c")] = truth[model.IndexOf("rotor_drag.k_y")] = 0.0;
  SimulationOptions options;
  options.trajectory = "aggressive";
  const FlightLog log = Simulate(model, truth, options, SimulationNoise()).log;
  const Flown flown{vehicle, ThinnedFlight(FilterFlight(log, vehicle.num_rotors(), {}), {}), {}};
  const ResidualModel residual(&flown.flight, &flown.vehicle, true);
  const Attribution attribution = Attribute(flown, residual);
  ASSERT_FALSE(attribution.effects().empty());
  const RankedEffect& found = attribution.effects().front();
  EXPECT_EQ(found.name, "rotor_drag");
  EXPECT_GT(found.score, 30.0);
  EXPECT_NEAR(found.Find("rotor_drag.k_d")->value, truth[k_d], 0.3 * truth[k_d]);
}

// The force of skewed inflow of one axis is a vertical force by sideways speed.
TEST(Evidence, LooksAtNoFunctionThatCopiesAnEffect) {
  const Vehicle vehicle = UndeclaredVehicles()[1];
  Vehicle true_vehicle = vehicle;
  true_vehicle.effects.emplace_back("skewed_inflow");
  const DynamicModel model(true_vehicle, true_vehicle.effects);
  ModelValues truth = DefaultTruth(model);
  const int k_y = model.IndexOf("skewed_inflow.k_y");
  truth[k_y] = 0.5 * model.parameters()[k_y].spec.prior_sigma;
  truth[model.IndexOf("skewed_inflow.k_x")] = 0.0;
  SimulationOptions options;
  options.trajectory = "aggressive";
  const FlightLog log = Simulate(model, truth, options, SimulationNoise()).log;
  const Flown flown{vehicle, ThinnedFlight(FilterFlight(log, vehicle.num_rotors(), {}), {}), {}};
  const ResidualModel residual(&flown.flight, &flown.vehicle, false);
  const Instruments instruments(flown.flight, flown.vehicle);
  const std::vector<FlightWithInstruments> flights = {{&residual, &instruments}};
  Evidence evidence(flights, DeclaredPoint(vehicle));
  const int inflow = evidence.Add({"skewed_inflow", {}, {}});
  evidence.EstimateNoise();
  const FlexibleFeatures features(flights);
  const auto best = evidence.BestFlexible({}, features, {});
  EXPECT_EQ(best.Text(features), "force_z by \"sideways speed\"");
  const auto done = evidence.DoneBy(inflow, evidence.Solve({inflow}));
  const auto other = evidence.BestFlexible({}, features, {true, &done});
  EXPECT_NE(other.Text(features), best.Text(features));
  EXPECT_LT(other.nats, best.nats);
}

// Root mean squares of rotor speeds show no torque. Another flight of the vehicle does.
TEST(Evidence, AddsFunctionsToFlightsWithAndWithoutTorque) {
  const Flown flown = Filtered(Make({"quadratic_drag"}, 0.7, "aggressive", 0, 31));
  const ResidualModel whole(&flown.flight, &flown.vehicle, true);
  const ResidualModel force_only(&flown.flight, &flown.vehicle, false);
  const Instruments instruments(flown.flight, flown.vehicle);
  const std::vector<FlightWithInstruments> flights = {{&whole, &instruments},
                                                      {&force_only, &instruments}};
  Evidence evidence(flights, DeclaredPoint(flown.vehicle));
  evidence.EstimateNoise();
  const FlexibleFeatures features(flights);
  const auto best = evidence.BestFlexible({}, features, {});
  ASSERT_GT(best.nats, 20.0);
  const int added = evidence.AddFlexible(best, features);
  const auto done = evidence.DoneBy(added, evidence.Solve({added}));
  ASSERT_EQ(done.size(), 2u);
  const Eigen::Index n = done[1].size() / 3;
  ASSERT_EQ(done[0].size(), 6 * n);
  EXPECT_GT(done[1].squaredNorm(), 20.0);
  EXPECT_EQ(done[0].tail(3 * n).squaredNorm(), 0.0);  // a force
  // Each by the noise of its own fit.
  EXPECT_NEAR(done[0].head(3 * n).squaredNorm(), done[1].squaredNorm(),
              0.05 * done[1].squaredNorm());
}

TEST(Evidence, NamesBothOfTwoThatActOnDifferentAxes) {
  const UndeclaredFlight flight = Make({"quadratic_drag", "hub_moment"}, 0.5, "aggressive", 0, 7);
  const Flown flown = Filtered(flight);
  const ResidualModel residual(&flown.flight, &flown.vehicle, true);
  const Attribution attribution = Attribute(flown, residual);
  EXPECT_TRUE(Has(attribution.effects(), "quadratic_drag"));
  EXPECT_TRUE(Has(attribution.effects(), "hub_moment"));
  for (const RankedEffect& effect : attribution.effects()) {
    ASSERT_EQ(effect.alternative_shares.size(), effect.alternatives.size()) << effect.name;
    double sum = 0.0;
    for (const double share : effect.alternative_shares) sum += share;
    EXPECT_LT(sum, 1.0) << effect.name;
  }
}

// A load that is dropped is wild for an instant. What a slightly wrong formula would leave of that
// does not stand for all that acts beside it.
TEST(Evidence, CountsALoadThatIsDroppedAsNoMoreThanWild) {
  const Vehicle vehicle = UndeclaredVehicles().front();
  Vehicle loaded = vehicle;
  loaded.effects.emplace_back("mass_change");
  const DynamicModel model(loaded, loaded.effects);
  ModelValues truth = DefaultTruth(model);
  truth[model.IndexOf("mass_change.mass")] = -0.3 * vehicle.mass_kg;
  truth[model.IndexOf("mass_change.from")] = 8.0;
  SimulationOptions options;
  options.trajectory = "hover";
  SimulationNoise noise = SimulationNoise::None();
  noise.imu = true;
  const FlightLog log = Simulate(model, truth, options, noise).log;
  const Flown flown{vehicle, ThinnedFlight(FilterFlight(log, vehicle.num_rotors(), {}), {}), {}};
  const ResidualModel residual(&flown.flight, &flown.vehicle, true);
  const Instruments instruments(flown.flight, flown.vehicle);
  Evidence evidence({{&residual, &instruments}}, DeclaredPoint(flown.vehicle));
  const std::vector<EffectCandidate> all = CandidatesFor(flown.vehicle, flown.flight.motion());
  const auto load = std::find_if(all.begin(), all.end(), [](const EffectCandidate& c) {
    return c.effect == "mass_change" && c.start.at("mass_change.mass") < 0.0;
  });
  ASSERT_NE(load, all.end());
  EffectCandidate dropped = *load;
  dropped.settings.at("mass_change.from") = 8.0;
  const int variant = evidence.Add(dropped);
  evidence.EstimateNoise();
  const EffectFit fit = evidence.Solve({variant});
  double energy = 0.0;
  for (const double of_channel : evidence.EnergyOf(variant, fit)) energy += of_channel;
  const VectorXd done = evidence.DoneBy(variant, fit).front();
  EXPECT_GT(energy, 20.0);
  EXPECT_LT(energy, 0.75 * 0.5 * done.squaredNorm());
  EXPECT_EQ(WildShare(-3.0), 1.0);
  EXPECT_EQ(WildShare(-50.0), 0.1);
}

// Our own simulator's feedback goes through noise and unsteady air: rotors answer both.
TEST(Evidence, NamesNothingOnFlightsWithoutEffects) {
  const char* const trajectories[] = {"hover", "vertical", "yaw", "circle", "octo", "aggressive"};
  int alarms = 0;
  for (int seed = 0; seed < 12; ++seed) {
    const Flown flown = Filtered(Make({}, 0.0, trajectories[seed % 6], seed % 4, 500 + seed));
    const ResidualModel residual(&flown.flight, &flown.vehicle, true);
    const Attribution attribution = Attribute(flown, residual);
    if (attribution.effects().empty()) continue;
    ++alarms;
    ADD_FAILURE() << "seed " << 500 + seed << ", " << trajectories[seed % 6] << ": "
                  << attribution.effects().front().name << " "
                  << attribution.effects().front().score;
  }
  EXPECT_LE(alarms, 1);  // at 1 % each, two of twelve once in 170 runs
}

TEST(Evidence, PValuesFallWithTheGainAndAgreeWithSurrogates) {
  const Flown flown = Filtered(Make({}, 0.0, "octo", 2, 77));
  const ResidualModel residual(&flown.flight, &flown.vehicle, true);
  const Attribution attribution = Attribute(flown, residual);
  double last = 2.0;
  for (double gain = -5.0; gain < 60.0; gain += 1.0) {
    const double p = attribution.PValue(gain);
    EXPECT_GT(p, 0.0);
    EXPECT_LE(p, last);
    last = p;
  }
  for (const double share : {0.09, 0.05, 0.01, 1e-4}) {
    EXPECT_NEAR(attribution.SurrogatePValue(attribution.NullGain(share)), share, 1e-9);
  }
}

// No allowed size of this vehicle's effect shows the planned 0.3 of the residual on any trajectory.
TEST(MakeUndeclared, CallsWhatShowsLessThanPlannedByItsRealStrength) {
  const UndeclaredFlight flight = Make({"anisotropic_hvt"}, 0.3, "octo", 3, 41099);
  EXPECT_LT(flight.share, 0.1);
  EXPECT_EQ(flight.plan.strength, "weak");
  EXPECT_EQ(flight.plan.share, 0.08);
}

// Noise of rotor speeds may be all there is of a torque about z. What coupling about the other axes
// says of that inertia is then whatever else acts there.
TEST(Evidence, HoldsAnInertiaOfWhoseTorqueNothingIsForeseen) {
  for (const bool is_noise : {false, true}) {
    UndeclaredFlight made = Make({"rotor_gyroscopic"}, 0.5, "lemniscate", 0, 7);
    Gaussian random(7, 0);
    for (RotorSample& sample : made.log.rotors) {
      const double e = is_noise ? 0.35 * sample.speed.mean() * random.Next() : 0.0;
      for (int j = 0; j < made.declared.num_rotors(); ++j) {
        sample.speed[j] += made.declared.rotors[static_cast<size_t>(j)].spin * e;
      }
    }
    const Flown flown = Filtered(made);
    const ResidualModel residual(&flown.flight, &flown.vehicle, true);
    const Instruments instruments(flown.flight, flown.vehicle);
    Evidence evidence({{&residual, &instruments}}, DeclaredPoint(flown.vehicle));
    evidence.EstimateNoise();
    const EffectFit fit = evidence.Solve({});
    bool found = false;
    for (size_t k = 0; k < fit.columns.size(); ++k) {
      const Evidence::Column& column = evidence.column(fit.columns[k]);
      if (column.name != "inertia.z") continue;
      const auto at = static_cast<Eigen::Index>(k);
      const double told = std::abs(fit.coefficients[at] - column.prior_mean) / column.prior_sigma;
      const double sigma = std::sqrt(fit.covariance(at, at)) / column.prior_sigma;
      found = true;
      if (is_noise) {
        EXPECT_LT(told, 0.2);
        EXPECT_GT(sigma, 0.95);
      } else {
        EXPECT_LT(sigma, 0.3);
      }
    }
    EXPECT_TRUE(found);
  }
}

}  // namespace
/// Rows of the table under a heading of docs/closing_the_loop.md, as "name value".
std::vector<std::string> DocumentedNumbers() {
  std::ifstream file(ODMC_SOURCE_DIR "/docs/closing_the_loop.md");
  std::vector<std::string> rows;
  bool inside = false;
  for (std::string line; std::getline(file, line);) {
    if (line.rfind("## ", 0) == 0) inside = line == "## Every number of the decision";
    if (!inside || line.rfind("| `", 0) != 0) continue;
    const size_t end = line.find('`', 3), bar = line.find('|', end + 3);
    rows.push_back(line.substr(3, end - 3) + " " + line.substr(end + 4, bar - end - 5));
  }
  return rows;
}

TEST(UnexplainedStructure, CountsWhatActsAndWhatHardlyDoes) {
  const AttributionOptions options;
  ResidualModel::Wrenches before(200, kNumChannels);
  for (Eigen::Index i = 0; i < before.rows(); ++i) {
    before.row(i).setConstant(std::sin(0.1 * static_cast<double>(i)));
  }
  std::vector<ChannelStructure> structured(kNumChannels), left(kNumChannels);
  structured[0].whiteness = {1e-12, 0.9, 100.0, 1.0};
  left[0].whiteness = {1e-12, 0.5, 30.0, 1.0};
  ResidualModel::Wrenches after = before;
  after.col(0) *= 0.5;
  EXPECT_DOUBLE_EQ(UnexplainedStructure(before, after, structured, left, options), 0.3);
  // It acts on another channel, in which there is no structure: what it is the cause of is not
  // seen.
  after = before;
  after.col(3) *= 0.5;
  EXPECT_DOUBLE_EQ(UnexplainedStructure(before, after, structured, left, options), 0.0);
  after = before;
  after.col(3) *= 0.99;
  EXPECT_DOUBLE_EQ(UnexplainedStructure(before, after, structured, left, options), 0.0);
  // It hardly acts anywhere.
  after = before;
  EXPECT_DOUBLE_EQ(UnexplainedStructure(before, after, structured, structured, options), 1.0);
  after = 0.99 * before;
  EXPECT_DOUBLE_EQ(UnexplainedStructure(before, after, structured, structured, options), 1.0);
  EXPECT_DOUBLE_EQ(UnexplainedStructure(before, after, left, left, options), 1.0);
  const std::vector<ChannelStructure> none(kNumChannels);
  EXPECT_DOUBLE_EQ(UnexplainedStructure(before, after, none, none, options), 0.0);
}

TEST(UnexplainedStructure, ErrorsOfTheFitDoNotCount) {
  const AttributionOptions options;
  ResidualModel::Wrenches before(200, kNumChannels);
  for (Eigen::Index i = 0; i < before.rows(); ++i) {
    before.row(i).setConstant(std::sin(0.1 * static_cast<double>(i)));
  }
  ResidualModel::Wrenches after = before;
  after.col(2) *= 0.5;  // the effect, of force z, explains all of it there
  after.col(0) *= 0.5;
  std::vector<ChannelStructure> of_estimate(kNumChannels), of_fit(kNumChannels), left(kNumChannels);
  of_estimate[2].whiteness = of_fit[2].whiteness = {1e-12, 0.9, 100.0, 1.0};
  of_fit[0].whiteness = left[0].whiteness = {1e-12, 0.9, 300.0, 1.0};  // left by the fit alone
  EXPECT_DOUBLE_EQ(UnexplainedStructure(before, after, of_fit, left, options), 0.75);
  DropErrorsOfFit(of_estimate, options, &of_fit);
  EXPECT_DOUBLE_EQ(UnexplainedStructure(before, after, of_fit, left, options), 0.0);
  EXPECT_DOUBLE_EQ(of_fit[2].whiteness.p, 1e-12) << "what both leave stays";
}

TEST(AttributionOptions, DocumentationListsEveryNumber) {
  std::vector<std::string> numbers;
  for (const DecisionNumber& n : DecisionNumbers()) numbers.push_back(n.name + " " + n.TextOf({}));
  EXPECT_LT(numbers.size(), 25u);
  EXPECT_EQ(numbers, DocumentedNumbers());
}

TEST(AttributionOptions, CommandLineSetsOneNumber) {
  AttributionOptions options;
  EXPECT_EQ(DescribeChanges(options), "defaults");
  SetDecision("form_share=0.2", &options);
  SetDecision("most_effects=2", &options);
  EXPECT_DOUBLE_EQ(options.form_share, 0.2);
  EXPECT_EQ(DescribeChanges(options), "most_effects 2, form_share 0.2");
  for (const char* wrong : {"form_share=2", "form_share=x", "form_share=", "form_share=nan",
                            "most_effects=1.5", "form_share", "nothing=1"}) {
    EXPECT_THROW(SetDecision(wrong, &options), std::invalid_argument) << wrong;
  }
}

}  // namespace odmc
