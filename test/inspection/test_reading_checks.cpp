#include <gtest/gtest.h>

#include <algorithm>
#include <functional>

#include "odmc/inspection/reading_checks.h"
#include "odmc/sim/simulator.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace {

using Spoil = std::function<void(FlightLog*)>;

FlightLog Fly(const std::string& trajectory, double position_m) {
  const Vehicle vehicle = test::NominalVehicle();
  const DynamicModel model(vehicle, vehicle.effects);
  SimulationOptions options;
  options.trajectory = trajectory;
  options.seed = 3;
  options.duration_s = 15.0;
  options.log_rate_hz = 200.0;
  SimulationNoise noise;
  noise.position_m = position_m;
  noise.rotor_speed_rad_s = 2.0;
  FlightLog log = Simulate(model, model.InitialValues(), options, noise).log;
  log.battery.clear();
  for (const OdometrySample& s : log.odometry) log.battery.push_back({s.stamp, 15.2});
  return log;
}

const FlightLog& Octo() {
  static const FlightLog kLog = Fly("octo", 0.003);
  return kLog;
}

std::vector<Finding> Spoiled(const Spoil& spoil) {
  FlightLog log = Octo();
  spoil(&log);
  return CheckReadings(log, test::NominalVehicle());
}

/// Expects exactly one finding, of this check.
Finding Only(const std::vector<Finding>& findings, const std::string& check) {
  EXPECT_EQ(findings.size(), 1u) << check;
  if (findings.empty()) return {};
  EXPECT_EQ(findings.front().check, check) << findings.front().what;
  return findings.front();
}

TEST(ReadingChecks, SoundFlightsGetNoFinding) {
  for (const char* trajectory : {"octo", "aggressive", "hover"}) {
    for (const double position_m : {0.0005, 0.003, 0.02}) {
      const auto findings = CheckReadings(Fly(trajectory, position_m), test::NominalVehicle());
      EXPECT_TRUE(findings.empty())
          << trajectory << " " << position_m << ": " << Sentence(findings.front());
    }
  }
}

TEST(ReadingChecks, NamesRotorSpeedsOfAnotherClock) {
  const Finding finding = Only(Spoiled([](FlightLog* log) {
                                 for (RotorSample& s : log->rotors) s.stamp += FromSeconds(1000.0);
                               }),
                               "clocks");
  EXPECT_EQ(finding.leaves, Trust::kBad);
}

TEST(ReadingChecks, NamesHolesWithTheirLengthAndTime) {
  const Stamp zero = Octo().odometry.front().stamp;
  const Finding finding = Only(Spoiled([&](FlightLog* log) {
                                 auto& poses = log->odometry;
                                 poses.erase(std::remove_if(poses.begin(), poses.end(),
                                                            [&](const OdometrySample& s) {
                                                              const double t_s =
                                                                  ToSeconds(s.stamp - zero);
                                                              return t_s > 5.0 && t_s < 5.5;
                                                            }),
                                             poses.end());
                               }),
                               "holes");
  ASSERT_TRUE(finding.span_s);
  EXPECT_NEAR(finding.span_s->first, 5.0, 0.02);
  EXPECT_NEAR(finding.span_s->second, 5.5, 0.02);
}

TEST(ReadingChecks, NamesAPositionThatJumps) {
  const Finding finding =
      Only(Spoiled([](FlightLog* log) {
             for (size_t i = log->odometry.size() / 2; i < log->odometry.size(); ++i) {
               log->odometry[i].p_WS.x() += 0.3;
             }
           }),
           "pose_jump");
  ASSERT_TRUE(finding.span_s);
  EXPECT_NEAR(finding.span_s->first,
              0.5 * ToSeconds(Octo().odometry.back().stamp - Octo().odometry.front().stamp), 0.1);
}

TEST(ReadingChecks, NamesAPoseThatStaysInFlight) {
  const Finding finding = Only(Spoiled([](FlightLog* log) {
                                 for (size_t i = 1200; i < 1400; ++i) {
                                   const Stamp stamp = log->odometry[i].stamp;
                                   log->odometry[i] = log->odometry[1199];
                                   log->odometry[i].stamp = stamp;
                                 }
                               }),
                               "frozen_pose");
  ASSERT_TRUE(finding.span_s);
  EXPECT_NEAR(finding.span_s->second - finding.span_s->first, 1.0, 0.02);
}

TEST(ReadingChecks, NamesRotorSpeedsThatEndAtALimit) {
  const Finding finding = Only(Spoiled([](FlightLog* log) {
                                 std::vector<double> second;
                                 for (const RotorSample& s : log->rotors)
                                   second.push_back(s.speed[1]);
                                 std::sort(second.begin(), second.end());
                                 const double limit = second[second.size() * 9 / 10];
                                 for (RotorSample& s : log->rotors)
                                   s.speed[1] = std::min(s.speed[1], limit);
                               }),
                               "rotor_limit");
  EXPECT_NE(finding.what.find("rotor2 "), std::string::npos) << finding.what;
}

TEST(ReadingChecks, CoarseReadingsAreNoLimit) {
  const auto findings = Spoiled([](FlightLog* log) {
    for (RotorSample& s : log->rotors) s.speed = (s.speed / 10.0).array().round() * 10.0;
  });
  EXPECT_TRUE(findings.empty()) << Sentence(findings.front());
}

TEST(ReadingChecks, NamesTheUnitOfTheBattery) {
  const Finding finding = Only(Spoiled([](FlightLog* log) {
                                 for (BatterySample& s : log->battery) s.voltage_V *= 1e3;
                               }),
                               "battery_unit");
  EXPECT_NE(finding.what.find("mV"), std::string::npos) << finding.what;
  for (const double cells : {3.0, 6.0, 8.0}) {
    EXPECT_TRUE(Spoiled([&](FlightLog* log) {
                  for (BatterySample& s : log->battery) s.voltage_V = 3.8 * cells;
                }).empty())
        << cells;
  }
}

}  // namespace
}  // namespace odmc
