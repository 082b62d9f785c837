// What a flight can tell at all, before anything is fitted.

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <string>

#include "odmc/analysis/flight_motion.h"
#include "odmc/attribution/candidates.h"
#include "odmc/attribution/ranking.h"
#include "odmc/attribution/undeclared.h"

namespace odmc {
namespace {

struct Flown {
  Vehicle vehicle;
  ThinnedFlight flight;
};

/// A flight in which nothing acts that the model lacks.
Flown Fly(const std::string& trajectory) {
  UndeclaredPlan plan;
  plan.kind = Undeclared::kNothing;
  plan.trajectory = trajectory;
  plan.vehicle = 0;
  plan.seed = 31;
  const UndeclaredFlight flight = MakeUndeclared(plan);
  const int rotors = flight.declared.num_rotors();
  return {flight.declared, ThinnedFlight(FilterFlight(flight.log, rotors, {}), BlockSplit())};
}

bool IsCandidate(const Flown& flown, const std::string& effect) {
  const std::vector<Candidate> all = CandidatesFor(flown.vehicle, flown.flight.motion());
  return std::any_of(all.begin(), all.end(),
                     [&](const Candidate& c) { return c.effect == effect; });
}

TEST(Candidates, GroundEffectNeedsHeightThatVaries) {
  EXPECT_FALSE(IsCandidate(Fly("circle"), "ground_effect"));
  EXPECT_TRUE(IsCandidate(Fly("vertical"), "ground_effect"));
}

TEST(ResidualModel, ShowsTheInertiaOfAxesThatAreShaken) {
  const auto shown = [](const std::string& trajectory) {
    const Flown flown = Fly(trajectory);
    return ResidualModel(&flown.flight, &flown.vehicle, true).ShowsInertia();
  };
  using Axes = std::array<bool, 3>;
  EXPECT_EQ(shown("aggressive"), (Axes{true, true, true}));
  EXPECT_EQ(shown("circle"), (Axes{true, true, false}));
  EXPECT_EQ(shown("yaw"), (Axes{false, false, true}));
}

TEST(Stage, HoldsAnInertiaThatTheFlightDoesNotShow) {
  const Flown flown = Fly("circle");
  const ResidualModel residual(&flown.flight, &flown.vehicle, true);
  const DynamicModel model(flown.vehicle, flown.vehicle.effects);
  ModelValues values = model.InitialValues();
  const int z = model.IndexOf("inertia.z");
  values[z] *= 1.3;
  std::vector<bool> observable(model.num_parameters(), true);
  Stage stage = StageOf(model, values, observable, residual);
  EXPECT_EQ(stage.vehicle.parameters.at("inertia.z").estimated, false);
  EXPECT_EQ(stage.values.at("inertia.z"), values[z]);
  EXPECT_NE(stage.vehicle.parameters["inertia.x"].estimated, false);
  // What nobody has seen goes back to its prior.
  observable[z] = false;
  stage = StageOf(model, values, observable, residual);
  EXPECT_EQ(stage.values.at("inertia.z"), model.parameters()[z].spec.prior_value);
}

}  // namespace
}  // namespace odmc
