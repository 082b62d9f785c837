#include <gtest/gtest.h>

#include "odmc/trajectory/waypoints_yaml.h"
#include "support/error_text.h"

namespace odmc {
namespace {

const char kTwo[] = "waypoints: [{position_m: [0, 0, 1]}, {position_m: [1, 2, 3], yaw_rad: 0.5}]\n";

WaypointFile Parse(const std::string& text) { return ParseWaypoints(text, "way.yaml"); }

TEST(WaypointsYaml, ReadsPositionsAndYaws) {
  const WaypointFile plan = Parse(kTwo);
  ASSERT_EQ(plan.waypoints.size(), 2u);
  EXPECT_EQ(plan.waypoints[1].p_WB, Eigen::Vector3d(1.0, 2.0, 3.0));
  EXPECT_FALSE(plan.waypoints[0].yaw.has_value());
  EXPECT_EQ(plan.waypoints[1].yaw, 0.5);
}

TEST(WaypointsYaml, KeepsTheDefaultsOfAbsentLimits) {
  const WaypointFile plan = Parse(std::string(kTwo) +
                                  "limits: {max_speed_m_s: 2.5, max_thrust_over_weight: 1.5, "
                                  "max_body_rate_rad_s: 4.0}\n");
  EXPECT_EQ(plan.limits.max_speed_m_s, 2.5);
  EXPECT_EQ(plan.limits.max_thrust_over_weight, 1.5);
  EXPECT_EQ(plan.limits.max_body_rate_rad_s, 4.0);
  EXPECT_EQ(plan.limits.max_yaw_rate_rad_s, FlightLimits().max_yaw_rate_rad_s);
  EXPECT_EQ(Parse(kTwo).limits.max_speed_m_s, FlightLimits().max_speed_m_s);
}

TEST(WaypointsYaml, TheExampleShowsTheDefaults) {
  const WaypointFile plan = LoadWaypoints(ODMC_SOURCE_DIR "/config/waypoints/example.yaml");
  EXPECT_EQ(plan.waypoints.size(), 5u);
  const FlightLimits defaults;
  EXPECT_EQ(plan.limits.max_speed_m_s, defaults.max_speed_m_s);
  EXPECT_EQ(plan.limits.max_thrust_over_weight, defaults.max_thrust_over_weight);
  EXPECT_EQ(plan.limits.min_thrust_over_weight, defaults.min_thrust_over_weight);
  EXPECT_EQ(plan.limits.max_body_rate_rad_s, defaults.max_body_rate_rad_s);
  EXPECT_EQ(plan.limits.max_yaw_rate_rad_s, defaults.max_yaw_rate_rad_s);
}

TEST(WaypointsYaml, NamesFileAndKeyOfWhatIsWrong) {
  const std::string two = kTwo;
  ODMC_EXPECT_ERROR(Parse("limits: {}"), "way.yaml: waypoints: is missing");
  ODMC_EXPECT_ERROR(Parse(two + "limit: {}"), "way.yaml: limit: unknown key 'limit'; did you mean");
  ODMC_EXPECT_ERROR(Parse(two + "limits: {speed: 2.0}"), "limits.speed: unknown key 'speed'");
  ODMC_EXPECT_ERROR(Parse(two + "limits: {max_speed_m_s: -2.0}"),
                    "way.yaml: limits: max_speed_m_s must be positive, not -2");
  ODMC_EXPECT_ERROR(Parse("waypoints: [{position: [0, 0, 1]}]"),
                    "way.yaml: waypoints[0].position: unknown key 'position'");
  ODMC_EXPECT_ERROR(Parse("waypoints: [{position_m: [0, 0]}]"),
                    "waypoints[0].position_m: must be three numbers");
  ODMC_EXPECT_ERROR(Parse("waypoints: [{position_m: [0, 0, 1]}]"),
                    "way.yaml: waypoints: a path needs at least two waypoints, not 1");
  ODMC_EXPECT_ERROR(Parse("waypoints: [{position_m: [0, 0, 1]}, {position_m: [0, 0, 1]}]"),
                    "waypoints[1] is at the same place as waypoints[0]");
  ODMC_EXPECT_ERROR(Parse("waypoints: [{position_m: [0, 0, .nan]}]"), "must be a finite number");
  ODMC_EXPECT_ERROR(LoadWaypoints("/no/such.yaml"), "/no/such.yaml: cannot be opened");
}

}  // namespace
}  // namespace odmc
