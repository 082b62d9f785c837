#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <memory>
#include <stdexcept>

#include "odmc/bench/controlled_flight.h"
#include "odmc/bench/experiments.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/test_actuator.h"

namespace odmc {
namespace {

ControlledFlightSetup MakeSetup(const std::string& trajectory, double duration_s, int seed = 1) {
  ControlledFlightSetup setup;
  setup.vehicle = test::NominalVehicle();
  setup.truth_model = std::make_shared<DynamicModel>(setup.vehicle, setup.vehicle.effects);
  setup.truth = DrawTruth(*setup.truth_model, seed);
  setup.trajectory.name = trajectory;
  setup.trajectory.ground_s = 1.0;
  setup.trajectory.duration_s = duration_s;
  setup.trajectory.from_origin = true;
  setup.estimator = OfflineOptions();
  setup.estimator.keyframe_rate_hz = 50.0;
  setup.estimator.detect_changes = true;
  setup.estimator.phases.near_ground_m = 0.3;
  setup.seed = seed;
  return setup;
}

double Accepted(const ControlledFlight& flight, const std::string& name) {
  return flight.accepted->Find(name)->value;
}

double Truth(const ControlledFlightSetup& setup, const std::string& name) {
  return setup.truth[setup.truth_model->IndexOf(name)];
}

TEST(ControlledFlight, RepeatsExactly) {
  const ControlledFlightSetup setup = MakeSetup("octo", 10.0);
  const ControlledFlight a = FlyControlled(setup), b = FlyControlled(setup);
  ASSERT_EQ(a.samples.size(), b.samples.size());
  for (size_t i = 0; i < a.samples.size(); ++i) ASSERT_EQ(a.samples[i].p_WB, b.samples[i].p_WB);
}

// Take-off with nominal parameters, hand-over in flight, landing: the estimate is that of the
// vehicle, and neither take-off nor touch-down has spoilt it. (With near_ground_m = 0 the second
// vehicle's k_f would end a tenth or more off.)
TEST(ControlledFlight, LearnsInFlightAndNotFromTheGround) {
  for (const int seed : {1, 2}) {
    const ControlledFlightSetup setup = MakeSetup("octo", 20.0, seed);
    const ControlledFlight flight = FlyControlled(setup);
    EXPECT_EQ(flight.crash, "");
    ASSERT_TRUE(flight.accepted);
    EXPECT_LT(flight.first_accepted_s, 8.0);
    EXPECT_NEAR(Accepted(flight, "thrust.k_f") / Truth(setup, "thrust.k_f"), 1.0, 0.01) << seed;
    EXPECT_NEAR(Accepted(flight, "inertia.x") / Truth(setup, "inertia.x"), 1.0, 0.05) << seed;
    EXPECT_NEAR(Accepted(flight, "drag.d_x") / Truth(setup, "drag.d_x"), 1.0, 0.1) << seed;
    EXPECT_LT(flight.samples.back().p_WB.z(), 0.02);  // it sits
    EXPECT_GE(flight.ground_spans.size(), 2u);
    EXPECT_LT(flight.control_ms_p99, 0.2);
  }
}

TEST(ControlledFlight, BouncesWithoutLearning) {
  ControlledFlightSetup setup = MakeSetup("hover", 12.0, 2);
  setup.world.ground_damping_ratio = 0.2;
  const ControlledFlight flight = FlyControlled(setup);
  EXPECT_EQ(flight.crash, "");
  ASSERT_TRUE(flight.accepted);
  EXPECT_NEAR(Accepted(flight, "thrust.k_f") / Truth(setup, "thrust.k_f"), 1.0, 0.02);
}

TEST(ControlledFlight, HalvesTheErrorOfAnUncompensatedFlight) {
  ControlledFlightSetup setup = MakeSetup("octo", 25.0);
  setup.trajectory.top_speed_m_s = 5.0;
  const TrackingErrors with = ErrorsOf(FlyControlled(setup));
  setup.controller.compensation = CompensatedEffects::None();
  const TrackingErrors without = ErrorsOf(FlyControlled(setup));
  EXPECT_LT(with.rmse_m.x(), 0.5 * without.rmse_m.x());
  EXPECT_LT(with.rmse_m.y(), 0.5 * without.rmse_m.y());
  EXPECT_LT(with.rmse_m.x(), 0.034);
  EXPECT_LT(with.rmse_m.y(), 0.032);
  EXPECT_LT(with.rmse_m.z(), 0.012);
}

// Its last word stays in use.
TEST(ControlledFlight, FliesOnWithoutTheEstimator) {
  ControlledFlightSetup setup = MakeSetup("octo", 25.0);
  setup.trajectory.top_speed_m_s = 5.0;
  setup.estimator_dies_at_s = 15.0;
  const ControlledFlight flight = FlyControlled(setup);
  EXPECT_EQ(flight.crash, "");
  const TrackingErrors late = ErrorsBetween(flight, 20.0, 29.0);
  EXPECT_LT(late.rmse_m.norm(), 0.015);
  ASSERT_FALSE(flight.handover.empty());
  EXPECT_EQ(flight.handover.back().to, HandoverState::kHolding);
}

TEST(ControlledFlight, FliesOnWhenTheEstimatorDiesBeforeItSaidAnything) {
  ControlledFlightSetup setup = MakeSetup("octo", 12.0);
  setup.estimator_dies_at_s = 1.5;
  const ControlledFlight flight = FlyControlled(setup);
  EXPECT_EQ(flight.crash, "");
  EXPECT_FALSE(flight.accepted);
  EXPECT_EQ(flight.samples.back().handover, HandoverState::kNominal);
}

// Whoever takes a load in flight weighs a sixth less in thrust coefficients: the mass is fixed.
TEST(ControlledFlight, LearnsALoadAndItsDrop) {
  ControlledFlightSetup setup = MakeSetup("octo", 30.0);
  setup.world.payload_kg = 0.2 * setup.vehicle.mass_kg;
  setup.world.payload_p_B_m = {0.0, 0.0, -0.03};
  setup.world.payload_attach_at_s = 15.0;
  const ControlledFlight flight = FlyControlled(setup);
  EXPECT_EQ(flight.crash, "");
  EXPECT_NEAR(1.2 * Accepted(flight, "thrust.k_f") / Truth(setup, "thrust.k_f"), 1.0, 0.02);
  EXPECT_LT(ErrorsBetween(flight, 20.0, 34.0).rmse_m.norm(), 0.02);
}

// Motors that are `gain` times as strong as everybody on board believes.
ControlledFlightSetup MakeThrottleSetup(double gain, int seed = 1) {
  ControlledFlightSetup setup = MakeSetup("octo", 20.0, seed);
  Vehicle truth = setup.vehicle;
  setup.vehicle.actuator = test::GenericActuator();
  truth.actuator = test::WithGain(test::GenericActuator(), gain);
  setup.truth_model = std::make_shared<DynamicModel>(truth, truth.effects);
  setup.trajectory.top_speed_m_s = 3.0;
  setup.by_throttle = true;
  return setup;
}

TEST(ControlledFlight, FliesByThrottleWithAnActuatorThatIsNotQuiteRight) {
  double rmse_m[3];
  const double gains[] = {0.97, 1.0, 1.03};
  for (int i = 0; i < 3; ++i) {
    const ControlledFlightSetup setup = MakeThrottleSetup(gains[i]);
    const ControlledFlight flight = FlyControlled(setup);
    EXPECT_EQ(flight.crash, "");
    rmse_m[i] = ErrorsBetween(flight, 10.0, 21.0).rmse_m.norm();
    EXPECT_LT(rmse_m[i], 0.03) << gains[i];
    ASSERT_TRUE(flight.accepted);
    EXPECT_NEAR(Accepted(flight, "thrust.k_f") / Truth(setup, "thrust.k_f"), 1.0, 0.01);
    EXPECT_LT(flight.log.battery.back().voltage_V, flight.log.battery.front().voltage_V - 0.1);
    EXPECT_GT(flight.log.commands.size(), flight.samples.size());
  }
  std::printf("by throttle, motors of 0.97, 1, 1.03: RMSE %.4f %.4f %.4f m\n", rmse_m[0], rmse_m[1],
              rmse_m[2]);
}

// Nobody on board has a rotor-speed sensor.
TEST(ControlledFlight, LearnsFromCommandsAlone) {
  for (const int seed : {1, 2}) {
    ControlledFlightSetup setup = MakeThrottleSetup(1.01, seed);
    setup.rotor_speed_from_commands = true;
    setup.world.rotor_rate_hz = 0.0;
    const ControlledFlight flight = FlyControlled(setup);
    EXPECT_EQ(flight.crash, "");
    EXPECT_TRUE(flight.log.rotors.empty());
    EXPECT_LT(ErrorsBetween(flight, 10.0, 21.0).rmse_m.norm(), 0.04);
    ASSERT_TRUE(flight.accepted);
    EXPECT_NEAR(Accepted(flight, "thrust.k_f") / Truth(setup, "thrust.k_f"), 1.0, 0.03) << seed;
    std::printf("from commands: k_f %.4f of truth, RMSE %.4f m\n",
                Accepted(flight, "thrust.k_f") / Truth(setup, "thrust.k_f"),
                ErrorsBetween(flight, 10.0, 21.0).rmse_m.norm());
  }
}

// The true actuator is inverted for whoever commands speeds.
TEST(ControlledFlight, FliesRotorSpeedsOfAVehicleWithAnActuator) {
  ControlledFlightSetup setup = MakeThrottleSetup(1.03);
  setup.by_throttle = false;
  setup.vehicle.actuator.reset();
  const ControlledFlight flight = FlyControlled(setup);
  EXPECT_EQ(flight.crash, "");
  EXPECT_LT(ErrorsBetween(flight, 10.0, 21.0).rmse_m.norm(), 0.02);
  setup.by_throttle = true;
  EXPECT_THROW(FlyControlled(setup), std::invalid_argument);
}

TEST(ControlledFlight, SurvivesAJumpOfTheOdometry) {
  ControlledFlightSetup setup = MakeSetup("hover", 15.0);
  setup.world.jump_at_s = 10.0;
  setup.world.jump_m = {0.8, 0.0, 0.0};
  const ControlledFlight flight = FlyControlled(setup);
  EXPECT_EQ(flight.crash, "");
  EXPECT_NEAR(flight.samples.back().p_WB.x(), -0.8, 0.1);  // where odometry says 0
}

TEST(ControlledFlight, SaysWhatACrashWas) {
  ControlledFlightSetup setup = MakeSetup("octo", 20.0);
  setup.world.damage_at_s = 8.0;
  setup.world.damage_share = 1.0;  // a rotor gone
  EXPECT_NE(FlyControlled(setup).crash, "");
}

TEST(ControlledFlight, StartsWarmFromASavedSet) {
  ControlledFlightSetup setup = MakeSetup("octo", 15.0);
  const ControlledFlight first = FlyControlled(setup);
  ASSERT_TRUE(first.accepted);
  setup.warm_start = first.accepted;
  setup.seed = 2;
  const ControlledFlight second = FlyControlled(setup);
  const double until_s = first.first_accepted_s;
  EXPECT_LT(ErrorsBetween(second, 0.0, until_s).rmse_m.z(),
            0.5 * ErrorsBetween(first, 0.0, until_s).rmse_m.z());
}

// Twenty times real time is asked of one core; machines that share theirs are slower.
TEST(ControlledFlight, IsMuchFasterThanRealTimeWithoutTheEstimator) {
  ControlledFlightSetup setup = MakeSetup("octo", 30.0);
  setup.estimates = false;
  const ControlledFlight flight = FlyControlled(setup);
  std::printf("%.0f times real time, control step p99 %.4f ms\n", flight.flown_s / flight.wall_s,
              flight.control_ms_p99);
  EXPECT_GT(flight.flown_s / flight.wall_s, 10.0);
}

TEST(Experiments, ReportEveryVariantAndRefuseOthers) {
  ExperimentOptions options;
  options.seeds = 1;
  options.duration_s = 20.0;
  const Experiment experiment = RunExperiment("wind", test::NominalVehicle(), options);
  const std::string report = ExperimentReport({experiment});
  for (const char* key : {"\"wind\"", "\"compensated\"", "\"uncompensated\"", "\"rmse_m\"",
                          "\"max_m\"", "\"spread_m\"", "\"seeds\": 1", "\"crashes\": 0"}) {
    EXPECT_NE(report.find(key), std::string::npos) << key;
  }
  EXPECT_THROW(RunExperiment("storm", test::NominalVehicle(), options), std::invalid_argument);
}

}  // namespace
}  // namespace odmc
