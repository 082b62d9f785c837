// What `inspect` says of a recording.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <string>

#include "odmc/analysis/flight_inspection.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace test {
namespace {

FlightLog Fly(const std::string& trajectory) {
  const Vehicle vehicle = NominalVehicle();
  const DynamicModel model(vehicle, vehicle.effects);
  SimulationOptions options;
  options.trajectory = trajectory;
  options.duration_s = 16.0;
  options.log_rate_hz = 200.0;
  FlightLog log = Simulate(model, DefaultTruth(model), options).log;
  log.file = trajectory + ".csv";
  return log;
}

const ParameterObservability* Find(const FlightInspection& inspection, const std::string& name) {
  const auto it =
      std::find_if(inspection.lessons.begin(), inspection.lessons.end(),
                   [&](const ParameterObservability& l) { return l.full_name == name; });
  return it != inspection.lessons.end() ? &*it : nullptr;
}

TEST(FlightInspection, SaysWhatASoundFlightHoldsAndTeaches) {
  const FlightInspection inspection = InspectFlight(Fly("octo"), NominalVehicle());
  EXPECT_TRUE(inspection.inspection.findings.empty()) << InspectionText(inspection);
  EXPECT_EQ(inspection.inspection.refusal, "");
  ASSERT_GE(inspection.streams.size(), 2u);
  EXPECT_EQ(inspection.streams[0].name, "poses");
  EXPECT_NEAR(inspection.streams[0].rate_Hz, 200.0, 0.5);
  EXPECT_EQ(inspection.streams[0].gaps, 0);
  EXPECT_LT(inspection.streams[0].jitter_s, 1e-5);
  ASSERT_TRUE(inspection.flown.has_value());
  EXPECT_GT(inspection.flown->speed_m_s, 1.0);
  ASSERT_NE(Find(inspection, "drag.d_x"), nullptr);
  EXPECT_TRUE(Find(inspection, "drag.d_x")->is_shown);
  EXPECT_TRUE(Find(inspection, "drag.d_x")->manoeuvre.empty());
  const auto report = nlohmann::json::parse(InspectionReport(inspection));
  EXPECT_EQ(report["trust"], "good");
  EXPECT_EQ(report["streams"][0]["samples"], inspection.streams[0].samples);
}

// Straight up and down nothing is learned of drag along x, and what would teach it is said.
TEST(FlightInspection, SaysWhatToFlyForWhatIsNotShown) {
  const FlightInspection inspection = InspectFlight(Fly("vertical"), NominalVehicle());
  ASSERT_NE(Find(inspection, "drag.d_x"), nullptr) << InspectionText(inspection);
  EXPECT_FALSE(Find(inspection, "drag.d_x")->is_shown);
  EXPECT_EQ(Find(inspection, "drag.d_x")->manoeuvre, "forward and back at several speeds");
  EXPECT_NE(InspectionText(inspection).find("fly forward and back at several speeds"),
            std::string::npos);
}

TEST(FlightInspection, CountsGapsAndRepeatedSamples) {
  FlightLog log = Fly("octo");
  log.odometry.erase(log.odometry.begin() + 1000, log.odometry.begin() + 1040);
  for (size_t i = 2000; i < 2200; ++i) log.rotors[i].speed = log.rotors[1999].speed;
  const std::vector<StreamFigures> streams = StreamsOf(log);
  EXPECT_EQ(streams[0].gaps, 1);
  EXPECT_NEAR(streams[0].longest_gap_s, 0.205, 1e-3);
  const auto rotors = std::find_if(streams.begin(), streams.end(),
                                   [](const auto& s) { return s.name == "rotor speeds"; });
  ASSERT_NE(rotors, streams.end());
  EXPECT_EQ(rotors->repeated, 200);
}

// A source that freezes, and a mass that is a fifth too large.
TEST(FlightInspection, NamesAFrozenPoseAndAWrongMass) {
  FlightLog log = Fly("octo");
  for (size_t i = 1500; i < 1600; ++i) {
    log.odometry[i].p_WS = log.odometry[1500].p_WS;
    log.odometry[i].q_WS = log.odometry[1500].q_WS;
  }
  const auto has = [](const FlightInspection& inspection, const std::string& check) {
    const auto& findings = inspection.inspection.findings;
    return std::any_of(findings.begin(), findings.end(),
                       [&](const Finding& f) { return f.check == check; });
  };
  const FlightInspection frozen = InspectFlight(log, NominalVehicle());
  EXPECT_TRUE(has(frozen, "frozen_pose")) << InspectionText(frozen);
  Vehicle heavy = NominalVehicle();
  heavy.mass_kg *= 1.2;
  const FlightInspection inspection = InspectFlight(Fly("octo"), heavy);
  EXPECT_TRUE(has(inspection, "weight")) << InspectionText(inspection);
  EXPECT_FALSE(has(inspection, "frozen_pose"));
  EXPECT_FALSE(has(InspectFlight(Fly("octo"), NominalVehicle()), "weight"));
}

// Two rotors exchanged: the finding names the order that fits.
TEST(FlightInspection, NamesAWrongRotorOrder) {
  FlightLog log = Fly("octo");
  for (RotorSample& s : log.rotors) std::swap(s.speed[0], s.speed[1]);
  const FlightInspection inspection = InspectFlight(log, NominalVehicle());
  const bool named =
      std::any_of(inspection.inspection.findings.begin(), inspection.inspection.findings.end(),
                  [](const Finding& f) { return f.check == "rotor_order"; });
  EXPECT_TRUE(named) << InspectionText(inspection);
  EXPECT_NE(InspectionText(inspection).find("rotor_order (bad)"), std::string::npos);
}

}  // namespace
}  // namespace test
}  // namespace odmc
