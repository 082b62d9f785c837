// A small set of flights with undeclared effects, as simulate_undeclared makes them.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <set>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "odmc/analysis/parallel.h"
#include "odmc/attribution/close_loop.h"
#include "odmc/bench/undeclared.h"

namespace odmc {
namespace test {
namespace {

constexpr int kSeed = 5, kFlights = 24;

bool Contains(const std::vector<std::string>& names, const std::string& name) {
  return std::find(names.begin(), names.end(), name) != names.end();
}

/// True if the verdict is right; of effects, if the first one found or one that it cannot be told
/// from is among the true ones.
bool IsRight(const UndeclaredFlight& flight, const ClosedLoop& loop) {
  if (NameOf(loop.verdict) != flight.right_answer) return false;
  if (loop.effects.empty()) return true;
  const AddedEffect& first = loop.effects.front();
  return Contains(flight.plan.effects, first.effect.name) ||
         std::any_of(first.alternatives.begin(), first.alternatives.end(),
                     [&](const std::string& name) { return Contains(flight.plan.effects, name); });
}

TEST(UndeclaredPlans, OfOneEffectHaveEveryStrengthOnEveryTrajectory) {
  std::set<std::pair<std::string, std::string>> flown;
  for (const UndeclaredPlan& plan : PlanOneEffect(kSeed, 9, "gust")) {
    EXPECT_EQ(plan.effects, std::vector<std::string>{"gust"});
    flown.insert({plan.trajectory, plan.strength});
  }
  EXPECT_EQ(flown.size(), 9u);  // three trajectories show gusts
}

TEST(UndeclaredPlans, OfUnknownEffectsNameNone) {
  for (const UndeclaredPlan& plan : PlanUnknown(kSeed, 4)) {
    EXPECT_EQ(plan.kind, UndeclaredKind::kUnknown);
    EXPECT_TRUE(plan.effects.empty());
    EXPECT_GT(plan.share, 0.0);
  }
}

TEST(UndeclaredSet, IsAnsweredAsMeasured) {
  const std::vector<UndeclaredPlan> plans = PlanUndeclared(kSeed, kFlights);
  std::vector<UndeclaredFlight> flights(plans.size());
  std::vector<ClosedLoop> loops(plans.size());
  const int jobs = std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
  CloseLoopOptions options;
  options.estimator.keyframe_rate_hz = 50.0;  // as good here as 100, in half the time
  ForEachOf(kFlights, jobs, [&](int i) {
    flights[i] = MakeUndeclared(plans[i]);
    const Vehicle& vehicle = flights[i].declared;
    loops[i] = CloseLoop(flights[i].log, vehicle, vehicle, options);
    flights[i].log = FlightLog();
  });
  int null_flights = 0, false_alarms = 0, unknown = 0, unexplained = 0, shown = 0, named = 0;
  for (int i = 0; i < kFlights; ++i) {
    const UndeclaredFlight& flight = flights[i];
    const bool right = IsRight(flight, loops[i]);
    if (flight.right_answer == "none") {
      ++null_flights;
      false_alarms += right ? 0 : 1;
    } else if (flight.right_answer == "unexplained") {
      ++unknown;
      unexplained += right ? 1 : 0;
    } else if (flight.plan.strength != "weak") {
      ++shown;
      named += right ? 1 : 0;
    }
    std::string truth, found;
    for (const std::string& name : flight.plan.effects) truth += " " + name;
    for (const AddedEffect& effect : loops[i].effects) found += " " + effect.effect.name;
    std::printf("%s %2d %-6s %-10s right: %s%s, found: %s%s\n", right ? "  " : "no", i,
                flight.plan.strength.c_str(), flight.plan.trajectory.c_str(),
                flight.right_answer.c_str(), truth.c_str(), NameOf(loops[i].verdict).c_str(),
                found.c_str());
  }
  std::printf("false alarms %d of %d, unexplained %d of %d, strong and medium named %d of %d\n",
              false_alarms, null_flights, unexplained, unknown, named, shown);
  ASSERT_GE(null_flights, 8);
  ASSERT_GE(unknown, 3);
  ASSERT_GE(shown, 6);
  EXPECT_LE(false_alarms, 1);
  EXPECT_GE(unexplained, unknown - 1);
  EXPECT_GE(named, (3 * shown + 3) / 4);
}

}  // namespace
}  // namespace test
}  // namespace odmc
