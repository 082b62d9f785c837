#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "odmc/trajectory/feasibility.h"
#include "odmc/trajectory/trajectory.h"
#include "support/error_text.h"
#include "support/temporary_folder.h"

namespace odmc {
namespace {

const char kExample[] = ODMC_SOURCE_DIR "/config/waypoints/example.yaml";

TrajectoryOptions OptionsOf(const std::string& name, double ground_s = 0.0, double duration_s = 0.0,
                            double top_speed_m_s = 0.0) {
  TrajectoryOptions options;
  options.name = name;
  options.ground_s = ground_s;
  options.duration_s = duration_s;
  options.top_speed_m_s = top_speed_m_s;
  return options;
}

double TopSpeed(const Trajectory& trajectory, double from_s, double to_s) {
  double top = 0.0;
  for (double t = from_s; t < to_s; t += 0.001) {
    top = std::max(top, trajectory.At(t).v_WB.norm());
  }
  return top;
}

// Times at which a derivative may step: `steps` jumps, and the plan of a file starts and ends.
bool IsSmoothAround(const Trajectory& trajectory, double time_s) {
  const FlatReference a = trajectory.At(time_s - 1e-3), c = trajectory.At(time_s + 1e-3);
  const bool waypoints = trajectory.name() == kExample;
  return !waypoints || (a.s_WB.norm() > 0.0) == (c.s_WB.norm() > 0.0);
}

void ExpectConsistent(const Trajectory& trajectory, double end_s) {
  const double h = 1e-4;
  for (double t = 0.0513; t < end_s; t += 0.0371) {
    if (!IsSmoothAround(trajectory, t)) continue;
    const FlatReference a = trajectory.At(t - h), b = trajectory.At(t), c = trajectory.At(t + h);
    EXPECT_LT((b.v_WB - (c.p_WB - a.p_WB) / (2 * h)).norm(), 1e-5) << t;
    EXPECT_LT((b.a_WB - (c.v_WB - a.v_WB) / (2 * h)).norm(), 1e-4) << t;
    EXPECT_LT((b.j_WB - (c.a_WB - a.a_WB) / (2 * h)).norm(), 1e-3) << t;
    EXPECT_LT((b.s_WB - (c.j_WB - a.j_WB) / (2 * h)).norm(), 0.1) << t;
    EXPECT_NEAR(b.d_yaw, (c.yaw - a.yaw) / (2 * h), 1e-5) << t;
    EXPECT_NEAR(b.dd_yaw, (c.d_yaw - a.d_yaw) / (2 * h), 1e-3) << t;
  }
}

class SmoothTrajectory : public ::testing::TestWithParam<std::string> {};

TEST_P(SmoothTrajectory, GivesTheDerivativesOfItsPosition) {
  ExpectConsistent(Trajectory(GetParam()), 30.0);
}

TEST_P(SmoothTrajectory, GivesThemFromGroundToGround) {
  const Trajectory trajectory(OptionsOf(GetParam(), 1.5, 9.0));
  ExpectConsistent(trajectory, trajectory.end_s() + 1.0);
}

TEST_P(SmoothTrajectory, HasNoStepUpToJerkFromGroundToGround) {
  const Trajectory trajectory(OptionsOf(GetParam(), 1.5, 9.0));
  const double h = 5e-5;
  for (double t = 1.0; t < trajectory.end_s() + 1.0; t += 2.0 * h) {
    const FlatReference a = trajectory.At(t - h), b = trajectory.At(t + h);
    ASSERT_LT((a.p_WB - b.p_WB).norm(), 2e-3) << t;
    ASSERT_LT((a.v_WB - b.v_WB).norm(), 5e-3) << t;
    ASSERT_LT((a.a_WB - b.a_WB).norm(), 1e-2) << t;
    ASSERT_LT((a.j_WB - b.j_WB).norm(), 0.1) << t;
    ASSERT_LT(std::abs(a.yaw - b.yaw) + std::abs(a.d_yaw - b.d_yaw), 1e-3) << t;
    ASSERT_LT(std::abs(a.dd_yaw - b.dd_yaw), 2e-2) << t;
  }
}

TEST_P(SmoothTrajectory, HasNoStepInSnapFromHoverToHover) {
  if (GetParam() == kExample) return;  // the plan of a file rests at its ends, snap aside
  const Trajectory trajectory(OptionsOf(GetParam(), 0.0, 9.0));
  const double h = 5e-5;
  for (double t = -0.1; t < trajectory.end_s() + 0.1; t += 2.0 * h) {
    ASSERT_LT((trajectory.At(t - h).s_WB - trajectory.At(t + h).s_WB).norm(), 0.5) << t;
  }
}

TEST_P(SmoothTrajectory, StopsWhereItsDurationEnds) {
  const Trajectory trajectory(OptionsOf(GetParam(), 0.0, 9.0));
  EXPECT_EQ(trajectory.end_s(), 9.0);
  const FlatReference end = trajectory.At(9.0), later = trajectory.At(20.0);
  EXPECT_LT(end.v_WB.norm() + end.a_WB.norm() + end.j_WB.norm(), 1e-9);
  EXPECT_LT(std::abs(end.d_yaw) + std::abs(end.dd_yaw), 1e-9);
  EXPECT_LT((end.p_WB - later.p_WB).norm(), 1e-9);
  EXPECT_GT(later.p_WB.z(), 0.5);
  EXPECT_FALSE(later.standing);
}

// Braking mirrors the ramp: on average half the rate for 2.5 s.
TEST_P(SmoothTrajectory, BrakesOverHalfTheWayOfFullRate) {
  const Trajectory ends(OptionsOf(GetParam(), 0.0, 9.0)), flies(GetParam());
  EXPECT_LT((ends.At(9.0).p_WB - flies.At(9.0 - 1.25).p_WB).norm(), 1e-9);
  EXPECT_NEAR(ends.At(9.0).yaw, flies.At(9.0 - 1.25).yaw, 1e-9);
}

TEST_P(SmoothTrajectory, FliesItsPathUntilItBrakes) {
  const Trajectory ends(OptionsOf(GetParam(), 1.5, 9.0)), flies(GetParam(), 1.5);
  for (double t = 0.0; t <= 4.5 + 9.0 - 2.5; t += 0.1) {
    EXPECT_EQ(ends.At(t).p_WB, flies.At(t).p_WB) << t;
  }
}

TEST_P(SmoothTrajectory, FollowsItsPathFasterAndSlower) {
  if (GetParam() == "hover" || GetParam() == "yaw") return;
  const double own = TopSpeed(Trajectory(GetParam()), 0.0, 122.5);
  for (const double speed : {0.5 * own, 0.9 * own}) {
    const Trajectory trajectory(OptionsOf(GetParam(), 0.0, 0.0, speed));
    EXPECT_NEAR(TopSpeed(trajectory, trajectory.ramp_s(), 242.5), speed, 2e-3 * speed);
  }
}

INSTANTIATE_TEST_SUITE_P(All, SmoothTrajectory,
                         ::testing::Values("hover", "octo", "circle", "vertical", "yaw",
                                           "aggressive", "vshape", "lemniscate", kExample),
                         [](const auto& instance) {
                           return instance.param == kExample ? "waypoints" : instance.param;
                         });

class EveryTrajectory : public ::testing::TestWithParam<std::string> {};

TEST_P(EveryTrajectory, StandsTakesOffAndLands) {
  const Trajectory trajectory(OptionsOf(GetParam(), 2.0, 10.0));
  EXPECT_EQ(trajectory.start_s(), 5.0);
  for (double t = -1.0; t < trajectory.end_s() + 2.0; t += 0.01) {
    const FlatReference r = trajectory.At(t);
    EXPECT_EQ(r.standing, t < 2.0 || t >= trajectory.end_s()) << t;
    EXPECT_GE(r.p_WB.z(), -0.05 - 1e-12) << t;
    const double motion = r.v_WB.norm() + r.a_WB.norm() + std::abs(r.d_yaw);
    EXPECT_TRUE(!r.standing || motion < 1e-12) << t;
    EXPECT_TRUE(t >= 2.0 || r.p_WB.z() == 0.0) << t;
  }
}

TEST_P(EveryTrajectory, ClimbsAndDescendsStraight) {
  const Trajectory trajectory(OptionsOf(GetParam(), 2.0, 10.0));
  const FlatReference start = trajectory.At(5.0), stop = trajectory.At(15.0);
  for (double t = 0.0; t < 5.0; t += 0.01) {
    const FlatReference r = trajectory.At(t);
    EXPECT_LT((r.p_WB - start.p_WB).head<2>().norm(), 1e-12) << t;
    EXPECT_GE(r.v_WB.z(), 0.0) << t;
  }
  for (double t = 15.0; t < trajectory.end_s() + 1.0; t += 0.01) {
    const FlatReference r = trajectory.At(t);
    EXPECT_LT((r.p_WB - stop.p_WB).head<2>().norm(), 1e-12) << t;
    EXPECT_LE(r.v_WB.z(), 1e-12) << t;
  }
}

TEST_P(EveryTrajectory, SitsASecondBeforeItStands) {
  const Trajectory trajectory(OptionsOf(GetParam(), 2.0, 10.0));
  const double end_s = trajectory.end_s();
  EXPECT_NEAR(trajectory.At(end_s - 2.0).p_WB.z(), 0.0, 1e-12);
  EXPECT_NEAR(trajectory.At(end_s - 2.0).v_WB.norm(), 0.0, 1e-9);
  EXPECT_NEAR(trajectory.At(end_s - 1.0).p_WB.z(), -0.05, 1e-12);
  EXPECT_NEAR(trajectory.At(end_s).p_WB.z(), -0.05, 1e-12);
  EXPECT_LT(TopSpeed(trajectory, 15.0, end_s), 2.0);
}

TEST_P(EveryTrajectory, FliesOnForEverWithoutADuration) {
  EXPECT_TRUE(std::isinf(Trajectory(GetParam(), 2.0).end_s()));
  EXPECT_FALSE(Trajectory(GetParam(), 2.0).At(1000.0).standing);
  EXPECT_GT(Trajectory(GetParam(), 2.0).At(1000.0).p_WB.z(), 0.5);
}

TEST_P(EveryTrajectory, IsWithinReachOfAnyQuadrotor) {
  const Trajectory trajectory(OptionsOf(GetParam(), 2.0, 30.0));
  const Feasibility found = CheckFeasibility([&](double t) { return trajectory.At(t); }, 0.0,
                                             trajectory.end_s(), {9.0, 3.0, 0.2, 5.0, 2.5}, 9.81);
  EXPECT_TRUE(found.ok()) << found.violations.front();
}

INSTANTIATE_TEST_SUITE_P(All, EveryTrajectory, ::testing::ValuesIn(Trajectory::Names()),
                         [](const auto& instance) { return instance.param; });

// The first six trajectories at their default durations and top speeds: recorded results depend on
// these values.
TEST(Trajectory, FliesTheFirstSixAsEver) {
  struct Golden {
    std::string name;
    double ground_s, time_s;
    Eigen::Vector3d p, v, s;
    double yaw, dd_yaw;
  };
  const std::vector<Golden> all = {
      {"hover", 0.0, 1.3, {0, 0, 2.5}, {0, 0, 0}, {0, 0, 0}, 0, 0},
      {"hover", 0.0, 6.7, {0, 0, 2.5}, {0, 0, 0}, {0, 0, 0}, 0, 0},
      {"hover", 2.0, 6.7, {0, 0, 2.5}, {0, 0, 0}, {0, 0, 0}, 0, 0},
      {"octo",
       0.0,
       1.3,
       {1.04643410879523, 0.553803314986924, 2.61627251756126},
       {2.8371915308506, 1.41958008390056, 0.316824042154831},
       {-30.8498045600775, -34.8997585726437, -3.02929336988431},
       0.164948798104751,
       0.700643353454348},
      {"octo",
       0.0,
       6.7,
       {0.303676572830768, 0.164681580979612, 2.03463233702134},
       {5.34730945824147, 2.88711349907078, 0.374938158610891},
       {0.55939037683547, 4.85365286012408, -0.44703032024033},
       -0.748383754782,
       0.36670803984318},
      {"octo", 2.0, 1.3, {0, 0, 0}, {0, 0, 0}, {0, 0, 0}, 0, 0},
      {"octo",
       2.0,
       6.7,
       {2.43598453458218, 1.12303034218236, 2.77400366972045},
       {3.84839095836399, 1.08272504637906, 0.447361720902608},
       {-8.16021326430642, 16.0167800015309, -0.920344752725809},
       0.394896314316045,
       0.318996835022607},
      {"circle",
       0.0,
       1.3,
       {1.84677516084446, 0.767737914452523, 2.5},
       {-0.834807601803764, 2.00810968700786, 0},
       {3.06226269605169, -39.9031176320025, 0},
       0,
       0},
      {"circle",
       0.0,
       6.7,
       {-0.190857702001901, -1.99087250661275, 2.5},
       {3.98174501322551, -0.381715404003803, 0},
       {-3.05372323203042, -31.8539601058041, 0},
       0,
       0},
      {"circle", 2.0, 1.3, {2, 0, 0}, {0, 0, 0}, {0, 0, 0}, 0, 0},
      {"circle",
       2.0,
       6.7,
       {1.15017690222523, 1.63618247563882, 2.5},
       {-2.7702717580678, 1.94740051091942, 0},
       {58.5473690972672, 7.09869005326827, 0},
       0,
       0},
      {"vertical",
       0.0,
       1.3,
       {0, 0, 2.96499011487902},
       {0, 0, 1.24055443962577},
       {0, 0, -18.6228463423821},
       0,
       0},
      {"vertical",
       0.0,
       6.7,
       {0, 0, 3.47179705887928},
       {0, 0, -1.8282130126069},
       {0, 0, 6.36876920507123},
       0,
       0},
      {"vertical",
       2.0,
       6.7,
       {0, 0, 3.54039205275971},
       {0, 0, 1.46360795823313},
       {0, 0, -1.58765479028376},
       0,
       0},
      {"yaw", 0.0, 1.3, {0, 0, 2.5}, {0, 0, 0}, {0, 0, 0}, 0.408668778742942, 1.59880977529854},
      {"yaw", 0.0, 6.7, {0, 0, 2.5}, {0, 0, 0}, {0, 0, 0}, 0.44323175192769, -0.638253722775874},
      {"yaw", 2.0, 6.7, {0, 0, 2.5}, {0, 0, 0}, {0, 0, 0}, 0.948772682506604, 0.0348737396646212},
      {"aggressive",
       0.0,
       1.3,
       {1.58192352631314, 2.27131035876821, 2.70022948219755},
       {4.08515474878641, -1.12336634410861, 0.490589216570702},
       {-93.2258166182435, 0.288958966448982, -15.0847258427593},
       0.341786533593516,
       1.09197741652188},
      {"aggressive",
       0.0,
       6.7,
       {0.0605041268098095, 2.31668573419829, 2.184735249822},
       {6.47826712098437, 0.955162453379746, -0.782039716954767},
       {-6.33708393259535, 52.2926533060092, -13.4486165763969},
       -0.0748007817553487,
       -1.1827163496121},
      {"aggressive", 2.0, 1.3, {0, 2.42705907663337, 0}, {0, 0, 0}, {0, 0, 0}, 0, 0},
      {"aggressive",
       2.0,
       6.7,
       {3.26782289951133, 1.22901413123194, 2.86873080049939},
       {3.43137998379211, -4.31057467305988, 0.212426832343993},
       {35.1972391553398, 123.163093565768, 25.2408749425432},
       0.743340031488032,
       -1.03707181781298},
  };
  for (const Golden& golden : all) {
    const FlatReference r = Trajectory(golden.name, golden.ground_s).At(golden.time_s);
    EXPECT_LT((r.p_WB - golden.p).norm(), 1e-13) << golden.name;
    EXPECT_LT((r.v_WB - golden.v).norm(), 1e-13) << golden.name;
    EXPECT_LT((r.s_WB - golden.s).norm(), 1e-12) << golden.name;
    EXPECT_NEAR(r.yaw, golden.yaw, 1e-13) << golden.name;
    EXPECT_NEAR(r.dd_yaw, golden.dd_yaw, 1e-13) << golden.name;
  }
}

TEST(Trajectory, LooksAlongTheLemniscate) {
  const Trajectory trajectory("lemniscate");
  for (double t = 0.3; t < 30.0; t += 0.01) {
    const FlatReference r = trajectory.At(t);
    const Eigen::Vector3d heading(std::cos(r.yaw), std::sin(r.yaw), 0.0);
    EXPECT_LT((heading - r.v_WB.normalized()).norm(), 1e-9) << t;
  }
  EXPECT_NEAR(trajectory.At(0.0).yaw, M_PI / 4.0, 1e-12);
}

TEST(Trajectory, PassesTheCornersOfTheV) {
  const Trajectory trajectory("vshape");
  const Eigen::Vector3d corners[] = {{-3.0, 2.5, 2.5}, {0.0, -2.5, 2.5}, {3.0, 2.5, 2.5}};
  for (const Eigen::Vector3d& corner : corners) {
    int visits = 0;
    bool was_near = false;
    for (double t = 0.0; t < 40.0; t += 0.001) {
      const bool is_near = (trajectory.At(t).p_WB - corner).norm() < 0.01;
      visits += is_near && !was_near ? 1 : 0;
      was_near = is_near;
    }
    EXPECT_GE(visits, 3) << corner.transpose();
  }
  EXPECT_NEAR(TopSpeed(trajectory, 0.0, 40.0), 3.5, 0.01);
}

TEST(Trajectory, StepsOneAxisEveryThreeSeconds) {
  const Trajectory trajectory("steps");
  FlatReference before = trajectory.At(1.5);
  EXPECT_EQ(before.p_WB, Eigen::Vector3d(0.0, 0.0, 2.5));
  for (int k = 1; k <= 16; ++k) {
    const FlatReference after = trajectory.At(1.5 + 3.0 * k);
    Eigen::Vector4d step;
    step << after.p_WB - before.p_WB, (after.yaw - before.yaw) * 4.0 / M_PI;
    EXPECT_NEAR(step[(k - 1) % 4], (k - 1) % 8 < 4 ? 1.0 : -1.0, 1e-12) << k;
    EXPECT_NEAR(step.norm(), 1.0, 1e-12) << k;
    EXPECT_EQ(after.v_WB.norm() + after.s_WB.norm() + std::abs(after.d_yaw), 0.0);
    before = after;
  }
  EXPECT_EQ(trajectory.At(2.999).p_WB.x(), 0.0);
  EXPECT_EQ(trajectory.At(3.001).p_WB.x(), 1.0);
}

TEST(Trajectory, FliesAWaypointFileOnce) {
  const Trajectory trajectory(kExample);
  EXPECT_EQ(trajectory.ramp_s(), 0.0);
  EXPECT_LT((trajectory.At(0.0).p_WB - Eigen::Vector3d(0.0, 0.0, 1.5)).norm(), 1e-9);
  const FlatReference end = trajectory.At(100.0);
  EXPECT_LT((end.p_WB - Eigen::Vector3d(0.0, 0.0, 1.5)).norm(), 1e-9);
  EXPECT_EQ(end.v_WB.norm() + end.s_WB.norm(), 0.0);
  EXPECT_NEAR(TopSpeed(trajectory, 0.0, 30.0), 5.0, 0.05);
}

TEST(Trajectory, KeepsToTheLimitsOfAWaypointFile) {
  EXPECT_NO_THROW(Trajectory(OptionsOf(kExample, 0.0, 0.0, 5.0)));
  ODMC_EXPECT_ERROR(Trajectory(OptionsOf(kExample, 0.0, 0.0, 5.2)), "top_speed_m_s is 5.2, but");
}

TEST(Trajectory, RefusesToTakeOffToAPlaceBelowTheGround) {
  const testing_support::TemporaryFolder folder;
  const std::string file =
      folder.Write("low.yaml", "waypoints: [{position_m: [0, 0, -1]}, {position_m: [0, 0, 1]}]");
  EXPECT_NO_THROW(Trajectory(file, 0.0));
  ODMC_EXPECT_ERROR(Trajectory(file, 1.0), "starts at a height of -1 m");
}

TEST(Trajectory, SaysWhichOptionIsWrong) {
  ODMC_EXPECT_ERROR(Trajectory("eight"),
                    "there is no trajectory 'eight'; known are: hover, octo, circle, vertical, "
                    "yaw, aggressive, vshape, lemniscate, steps, or a waypoint file (*.yaml)");
  ODMC_EXPECT_ERROR(Trajectory("nowhere.yaml"), "nowhere.yaml: cannot be opened");
  ODMC_EXPECT_ERROR(Trajectory("octo", -1.0), "ground_s must be at least 0, not -1");
  ODMC_EXPECT_ERROR(Trajectory(OptionsOf("octo", 0.0, 4.9)), "duration_s must be 0 (for ever)");
  ODMC_EXPECT_ERROR(Trajectory(OptionsOf("octo", 0.0, 0.0, -2.0)), "top_speed_m_s must be at");
  const double infinity = std::numeric_limits<double>::infinity();
  ODMC_EXPECT_ERROR(Trajectory(OptionsOf("octo", 0.0, infinity)), "duration_s must be 0");
  for (const char* name : {"hover", "yaw", "steps"}) {
    ODMC_EXPECT_ERROR(Trajectory(OptionsOf(name, 0.0, 0.0, 2.0)), "has no speed");
  }
  EXPECT_TRUE(Trajectory::IsKnown("my/way.yaml"));
  EXPECT_FALSE(Trajectory::IsKnown(".yaml"));
}

struct KeyList {
  std::vector<std::string> keys;
  template <typename Value>
  void Field(const char* key, Value* /*value*/) {
    keys.push_back(key);
  }
};

TEST(TrajectoryOptions, ShowEveryField) {
  KeyList list;
  TrajectoryOptions().Visit(&list);
  EXPECT_EQ(list.keys, (std::vector<std::string>{"name", "ground_s", "top_speed_m_s", "from_origin",
                                                 "duration_s"}));
}

TEST(TrajectoryOptions, FromOriginMovesThePathAndNothingElse) {
  TrajectoryOptions options;
  options.name = "vshape";
  options.ground_s = 1.0;
  const Trajectory there(options);
  options.from_origin = true;
  const Trajectory here(options);
  EXPECT_LT(here.At(0.0).p_WB.norm(), 1e-12);
  const Eigen::Vector3d offset = there.At(0.0).p_WB;
  EXPECT_GT(offset.norm(), 1.0);
  for (const double t : {0.5, 3.0, 7.0, 20.0}) {
    EXPECT_LT((there.At(t).p_WB - here.At(t).p_WB - offset).norm(), 1e-12);
    EXPECT_EQ(there.At(t).v_WB, here.At(t).v_WB);
  }
}

}  // namespace
}  // namespace odmc
