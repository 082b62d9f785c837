// Offsets of streams that inspection takes off a recording, named by close_loop.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "odmc/attribution/close_loop_report.h"
#include "odmc/attribution/stream_effects.h"
#include "odmc/inspection/recording_inspection.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace test {
namespace {

TimeOffset Offset(const std::string& stream, double lag_s, double sigma_s) {
  TimeOffset offset;
  offset.stream = stream;
  offset.against = "body_rates";
  offset.lag.lag_s = lag_s;
  offset.lag.scatter_s = sigma_s;
  offset.lag.over_none = 2.0 * kLeastContrast;
  offset.compensated_s = lag_s;
  return offset;
}

/// @param reported with a finding
StreamInspection Inspected(const TimeOffset& offset, bool reported) {
  StreamInspection inspection;
  inspection.offsets = {offset};
  if (reported) inspection.findings = {OffsetFinding(offset, true)};
  return inspection;
}

AddedEffect Effect(const std::string& name, double score, const std::string& parameter,
                   double value) {
  AddedEffect added;
  added.effect.name = name;
  added.effect.score = score;
  added.effect.parameters = {{parameter, "s", value, 0.001, true, true}};
  return added;
}

TEST(StreamEffects, LateRotorSpeedsAreAnEffect) {
  for (const double lag_s : {0.035, -0.035}) {
    ClosedLoop loop;
    AddInspection(Inspected(Offset("rotor_speeds", lag_s, 0.001), true), CloseLoopOptions(),
                  NominalVehicle(), &loop);
    EXPECT_EQ(loop.verdict, Verdict::kEffect);
    ASSERT_EQ(loop.effects.size(), 1u);
    const RankedEffect& effect = loop.effects[0].effect;
    EXPECT_TRUE(loop.effects[0].taken_off);
    EXPECT_EQ(effect.name, "rotor_delay");
    EXPECT_DOUBLE_EQ(effect.Find("rotor_delay.delay")->value, lag_s);
    EXPECT_DOUBLE_EQ(effect.Find("rotor_delay.delay")->sigma, 0.001);
    // 35 sigmas, less the logarithm of how much narrower the posterior is than the prior.
    const double variance = 1e-6, prior = 4e-4 + variance;
    EXPECT_NEAR(
        effect.score,
        0.5 * lag_s * lag_s * (1.0 / variance - 1.0 / prior) + 0.5 * std::log(variance / prior),
        1e-9);
    EXPECT_GT(effect.probability, 0.999);
    EXPECT_EQ(loop.findings.size(), 1u);
    EXPECT_EQ(loop.warnings.size(), 1u);
  }
}

// A controller that answers noise makes rotors lead; the stamps as they are explain that as well.
TEST(StreamEffects, WhatTheStampsAsTheyAreExplainAsWellIsNoEffect) {
  for (const bool explains_more : {true, false}) {
    TimeOffset offset = Offset("rotor_speeds", -0.015, 0.003);
    offset.lag.over_none = (explains_more ? 1.01 : 0.99) * kLeastContrast;
    ClosedLoop loop;
    AddInspection(Inspected(offset, true), CloseLoopOptions(), NominalVehicle(), &loop);
    EXPECT_EQ(loop.verdict, explains_more ? Verdict::kEffect : Verdict::kNone);
    EXPECT_EQ(loop.effects.size(), explains_more ? 1u : 0u);
    EXPECT_EQ(loop.warnings.size(), 1u) << "that it was taken off is said in either case";
  }
}

// 10 ms, 3.4 sigma: one offset in 1,500 by chance, and one effect of 22 in 67.
TEST(StreamEffects, AreHeldToWhatHoldsForOthers) {
  const auto named = [](double sigma_s, const CloseLoopOptions& options) {
    ClosedLoop loop;
    loop.ranking.resize(22);
    AddInspection(Inspected(Offset("rotor_speeds", 0.01, sigma_s), true), options, NominalVehicle(),
                  &loop);
    EXPECT_EQ(loop.findings.size(), 1u);
    EXPECT_EQ(loop.verdict == Verdict::kEffect, !loop.effects.empty());
    return loop.effects.size();
  };
  CloseLoopOptions options;
  EXPECT_EQ(named(0.01 / 3.4, options), 0u);
  EXPECT_EQ(named(0.01 / 4.0, options), 1u);
  options.attribution.false_alarm_rate = 0.02;
  EXPECT_EQ(named(0.01 / 3.4, options), 1u);
  options.ruled_out = {"rotor_delay"};
  EXPECT_EQ(named(0.001, options), 0u);
  options.ruled_out.clear();
  options.attribution.most_effects = 0;
  EXPECT_EQ(named(0.001, options), 0u);
}

// Some milliseconds are on any recording, however surely they are seen.
TEST(StreamEffects, AnOrdinaryDelayIsAWarning) {
  for (const auto& [lag_s, num_named] :
       {std::pair<double, size_t>{0.004, 0}, {-0.004, 0}, {0.008, 1}}) {
    ClosedLoop loop;
    AddInspection(Inspected(Offset("rotor_speeds", lag_s, 0.0004), true), CloseLoopOptions(),
                  NominalVehicle(), &loop);
    EXPECT_EQ(loop.effects.size(), num_named) << lag_s;
    EXPECT_EQ(loop.verdict == Verdict::kEffect, num_named == 1) << lag_s;
    const bool warned =
        std::any_of(loop.warnings.begin(), loop.warnings.end(), [](const std::string& warning) {
          return warning.find("rotor_delay.delay is ") != std::string::npos;
        });
    EXPECT_EQ(warned, num_named == 0) << lag_s;
  }
}

TEST(StreamEffects, AFiltersLagIsNone) {
  ClosedLoop loop;
  AddInspection(Inspected(Offset("rotor_speeds", -0.006, 0.001), false), CloseLoopOptions(),
                NominalVehicle(), &loop);
  EXPECT_EQ(loop.verdict, Verdict::kNone);
  EXPECT_TRUE(loop.effects.empty());
  EXPECT_EQ(loop.time_offsets.size(), 1u);
}

TEST(StreamEffects, ALateVelocityIsAFindingOnly) {
  ClosedLoop loop;
  AddInspection(Inspected(Offset("velocity", 0.028, 0.0001), true), CloseLoopOptions(),
                NominalVehicle(), &loop);
  EXPECT_EQ(loop.verdict, Verdict::kNone);
  EXPECT_TRUE(loop.effects.empty());
  EXPECT_EQ(loop.findings.size(), 1u);
}

TEST(StreamEffects, StandAmongTheOthersByTheirScore) {
  ClosedLoop loop;
  loop.verdict = Verdict::kEffect;
  loop.effects = {Effect("quadratic_drag", 1e4, "quadratic_drag.c_q", 1.0),
                  Effect("wind", 1.0, "wind.w_x", 1.0)};
  AddInspection(Inspected(Offset("rotor_speeds", 0.02, 0.001), true), CloseLoopOptions(),
                NominalVehicle(), &loop);
  ASSERT_EQ(loop.effects.size(), 3u);
  EXPECT_EQ(loop.effects[1].effect.name, "rotor_delay");
}

TEST(StreamEffects, WhatIsLeftOfAnOffsetIsAdded) {
  ClosedLoop loop;
  loop.verdict = Verdict::kEffect;
  loop.effects = {Effect("rotor_delay", 12.0, "rotor_delay.delay", 0.004)};
  AddInspection(Inspected(Offset("rotor_speeds", 0.02, 0.003), true), CloseLoopOptions(),
                NominalVehicle(), &loop);
  ASSERT_EQ(loop.effects.size(), 1u);
  EXPECT_DOUBLE_EQ(loop.effects[0].effect.Find("rotor_delay.delay")->value, 0.024);
  EXPECT_GT(loop.effects[0].effect.score, 12.0);
}

TEST(StreamEffects, WhatStaysUnexplainedStaysSo) {
  ClosedLoop loop;
  loop.verdict = Verdict::kUnexplained;
  AddInspection(Inspected(Offset("rotor_speeds", 0.02, 0.001), true), CloseLoopOptions(),
                NominalVehicle(), &loop);
  EXPECT_EQ(loop.verdict, Verdict::kUnexplained);
  EXPECT_EQ(loop.effects.size(), 1u);
}

TEST(StreamEffects, WhatLiesBetweenSamplesFarApartIsWarnedOf) {
  StreamDoubt doubt;
  doubt.stream = "rotor_speeds";
  StreamInspection inspection;
  for (const double sparse_s : {0.01, 0.1}) {
    doubt.sparse_s = sparse_s;
    inspection.doubts = {doubt};
    for (const Verdict verdict : {Verdict::kNone, Verdict::kUnexplained}) {
      ClosedLoop loop;
      loop.verdict = verdict;
      AddInspection(inspection, CloseLoopOptions(), NominalVehicle(), &loop);
      const bool warns = sparse_s > 0.05 && verdict != Verdict::kNone;
      ASSERT_EQ(loop.warnings.size(), warns ? 1u : 0u) << sparse_s;
      if (warns) {
        EXPECT_EQ(
            loop.warnings[0],
            "of rotor_speeds there is one sample in 100 ms: what happens between them may be what "
            "stays unexplained");
      }
    }
  }
}

TEST(StreamEffects, WhatMayHideBetweenSamplesIsWarnedOf) {
  StreamDoubt doubt;
  doubt.stream = "rotor_speeds";
  doubt.sparse_s = 0.1;
  StreamInspection inspection;
  inspection.doubts = {doubt};
  for (const double share : {0.02, 0.9}) {
    ClosedLoop loop;
    loop.structure.resize(2);
    loop.structure[0].name = "force_z";
    loop.structure[1].name = "torque_x";
    loop.structure[1].whiteness.sampling_share = share;
    AddInspection(inspection, CloseLoopOptions(), NominalVehicle(), &loop);
    ASSERT_EQ(loop.warnings.size(), share > 0.05 ? 1u : 0u);
    if (share < 0.05) continue;
    EXPECT_EQ(
        loop.warnings[0],
        "of rotor_speeds there is one sample in 100 ms: what happens between them may be 90 % "
        "of the residual's variance (torque_x), and hide an effect");
  }
}

TEST(StreamEffects, AShiftThatTheModelTakesBackIsPutBack) {
  for (const auto& [left_s, is_none] :
       {std::pair<double, bool>{0.0085, true}, {0.0052, true}, {0.001, false}, {-0.008, false}}) {
    const TimeOffset offset = Offset("rotor_speeds", -0.008, 0.002);
    StreamInspection inspection = Inspected(offset, true);
    inspection.doubts = {{"rotor_speeds", 0.002}, {"rotor_speeds", 0.0, 1.04, 2}};
    FlightLog log;
    log.rotors.resize(1);
    ClosedLoop loop;
    loop.effects = {Effect("rotor_delay", 250.0, "rotor_delay.delay", left_s)};  // +- 1 ms
    EXPECT_EQ(!PutBack(loop, NominalVehicle(), &inspection, &log).empty(), is_none) << left_s;
    EXPECT_EQ(inspection.offsets[0].compensated_s, is_none ? 0.0 : -0.008);
    EXPECT_EQ(inspection.findings.size(), is_none ? 0u : 1u);
    ASSERT_EQ(inspection.doubts.size(), 2u);
    const double doubt_s = is_none ? std::hypot(left_s - 0.008, 0.001) : 0.0;
    EXPECT_DOUBLE_EQ(inspection.doubts.back().late_s, doubt_s);
    FlightLog shifted;
    shifted.rotors.resize(1);
    ShiftRotors(0.008, &shifted);
    EXPECT_EQ(log.rotors[0].stamp, is_none ? shifted.rotors[0].stamp : 0);
  }
}

// Some milliseconds are on every recording: 4 ms, four of its sigmas, are no reason to name a delay
// that the inspection alone saw.
TEST(StreamEffects, AShiftOfWhichAnOrdinaryDelayIsLeftIsPutBack) {
  const TimeOffset offset = Offset("rotor_speeds", -0.008, 0.002);
  StreamInspection inspection = Inspected(offset, true);
  FlightLog log;
  log.rotors.resize(1);
  ClosedLoop loop;
  loop.effects = {Effect("rotor_delay", 250.0, "rotor_delay.delay", 0.004)};  // +- 1 ms
  EXPECT_FALSE(PutBack(loop, NominalVehicle(), &inspection, &log).empty());
  EXPECT_EQ(inspection.offsets[0].compensated_s, 0.0);
}

// The flight is looked at as it was recorded, and nothing is named.
TEST(StreamEffects, NothingIsNamedWhereTheInspectionAloneErred) {
  const Vehicle vehicle = NominalVehicle();
  const DynamicModel truth(vehicle, vehicle.effects);
  SimulationOptions simulation;
  simulation.trajectory = "aggressive";
  simulation.duration_s = 12.0;
  FlightLog log = Simulate(truth, DefaultTruth(truth), simulation, SimulationNoise()).log;
  const ClosedLoop as_recorded = CloseLoop(log, vehicle, vehicle, CloseLoopOptions());
  ShiftRotors(-0.015, &log);
  const ClosedLoop loop =
      CloseLoopInspected(log, Inspected(Offset("rotor_speeds", -0.015, 0.003), true), vehicle,
                         vehicle, CloseLoopOptions());
  EXPECT_TRUE(loop.effects.empty()) << CloseLoopTable(loop);
  EXPECT_EQ(loop.verdict, as_recorded.verdict);
  EXPECT_EQ(loop.parameters.Find("thrust.k_f")->value,
            as_recorded.parameters.Find("thrust.k_f")->value);
  ASSERT_EQ(loop.time_offsets.size(), 1u);
  EXPECT_EQ(loop.time_offsets[0].compensated_s, 0.0);
  EXPECT_TRUE(loop.findings.empty());
  ASSERT_FALSE(loop.warnings.empty());
  EXPECT_NE(loop.warnings.back().find("left as they are"), std::string::npos);
}

// From the recording to the report.
TEST(StreamEffects, NamedInARecordingThatWasMended) {
  const Vehicle vehicle = NominalVehicle();
  const DynamicModel truth(vehicle, vehicle.effects);
  SimulationOptions simulation;
  simulation.trajectory = "aggressive";
  simulation.duration_s = 25.0;
  SimulationNoise noise;
  noise.imu = true;
  noise.rotor_delay_s = 0.03;
  FlightLog log = Simulate(truth, DefaultTruth(truth), simulation, noise).log;
  const StreamInspection inspection = InspectOrRefuse(vehicle, false, "", &log);
  ClosedLoop loop = CloseLoop(log, vehicle, vehicle, CloseLoopOptions());
  AddInspection(inspection, CloseLoopOptions(), NominalVehicle(), &loop);
  ASSERT_EQ(loop.verdict, Verdict::kEffect) << CloseLoopTable(loop);
  ASSERT_EQ(loop.effects.size(), 1u) << CloseLoopTable(loop);
  const ParameterEstimate* delay = loop.effects[0].effect.Find("rotor_delay.delay");
  ASSERT_NE(delay, nullptr);
  EXPECT_NEAR(delay->value, 0.03, 3.0 * delay->sigma + 0.001);
  const std::string report = CloseLoopReport(loop, vehicle);
  EXPECT_NE(report.find("\"taken_off_the_recording\": true"), std::string::npos);
}

}  // namespace
}  // namespace test
}  // namespace odmc
