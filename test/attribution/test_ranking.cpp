// What a flight can tell at all, and the fit of the declared model.

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <string>
#include <vector>

#include "odmc/analysis/flight_motion.h"
#include "odmc/attribution/candidates.h"
#include "odmc/attribution/close_loop.h"
#include "odmc/attribution/ranking.h"
#include "odmc/attribution/undeclared.h"

namespace odmc {
namespace {

struct Flown {
  Vehicle vehicle;
  ThinnedFlight flight;
};

Flown Filtered(const UndeclaredFlight& flight) {
  const int rotors = flight.declared.num_rotors();
  return {flight.declared, ThinnedFlight(FilterFlight(flight.log, rotors, {}), BlockSplit())};
}

/// A flight in which nothing acts that the model lacks.
Flown Fly(const std::string& trajectory) {
  UndeclaredPlan plan;
  plan.kind = Undeclared::kNothing;
  plan.trajectory = trajectory;
  plan.vehicle = 0;
  plan.seed = 31;
  return Filtered(MakeUndeclared(plan));
}

Stage DeclaredStage(const Vehicle& vehicle, const ParameterSet& known,
                    const ResidualModel& residual) {
  const DynamicModel model(vehicle, vehicle.effects);
  ModelValues values = model.InitialValues();
  for (int i = 0; i < model.num_parameters(); ++i) {
    const ParameterEstimate* p = known.Find(model.parameters()[i].full_name);
    if (p != nullptr) values[i] = p->value;
  }
  return StageOf(model, values, std::vector<bool>(model.num_parameters(), true), residual);
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

// Torque noise turns the body, and seen through one filter the two line up: a fit would have the
// air propel the rotation, and leave a residual that looks like structure.
TEST(Regressor, FeignsNoPropulsionFromNoise) {
  UndeclaredPlan plan;
  plan.kind = Undeclared::kNothing;
  plan.trajectory = "vertical";
  plan.vehicle = 2;
  plan.seed = 31008;
  const UndeclaredFlight flight = MakeUndeclared(plan);
  const Flown flown = Filtered(flight);
  const ResidualModel residual(&flown.flight, &flown.vehicle, true);
  Stage stage = DeclaredStage(flown.vehicle, flight.truth, residual);
  const Regressor regressor(&residual, &stage);
  for (const std::string name : {"drag.d_x", "drag.d_y", "drag.d_z", "viscous_torque.b_x",
                                 "viscous_torque.b_y", "viscous_torque.b_z"}) {
    EXPECT_LE(stage.values.at(name), 0.0) << name;
  }
  for (const ChannelStructure& channel :
       Structure(flown.flight, regressor.base().fit.plain_residual, residual.num_channels())) {
    EXPECT_FALSE(IsStructured(channel, CloseLoopOptions())) << channel.name;
  }
}

// The share an undeclared effect is said to have is what the declared model leaves of it.
TEST(MakeUndeclared, SharesAreWhatTheDeclaredModelLeaves) {
  struct Case {
    const char *effect, *trajectory;
    int vehicle;
  };
  for (const Case& c : {Case{"rotor_asymmetry", "octo", 1}, Case{"hub_moment", "circle", 2},
                        Case{"quadratic_drag", "aggressive", 0}}) {
    UndeclaredPlan plan;
    plan.kind = Undeclared::kOneEffect;
    plan.effects = {c.effect};
    plan.trajectory = c.trajectory;
    plan.vehicle = c.vehicle;
    plan.share = 0.5;
    plan.seed = 31075;
    const UndeclaredFlight flight = MakeUndeclared(plan);
    EXPECT_NEAR(flight.share, 0.5, 0.05) << c.effect;
    const Flown flown = Filtered(flight);
    const ResidualModel residual(&flown.flight, &flown.vehicle, true);
    Vehicle whole = flown.vehicle;
    whole.effects.push_back(c.effect);
    const DynamicModel truth(whole, whole.effects);
    ModelValues values = truth.InitialValues();
    for (int i = 0; i < truth.num_parameters(); ++i) {
      values[i] = flight.truth.Find(truth.parameters()[i].full_name)->value;
    }
    const ResidualModel::Wrenches noise = residual.Residual(truth, values);
    Stage stage = DeclaredStage(flown.vehicle, flight.truth, residual);
    const Regressor regressor(&residual, &stage);
    const ResidualModel::Wrenches& left = regressor.base().fit.plain_residual;
    double most = 0.0;
    for (int k = 0; k < kNumChannels; ++k) {
      most = std::max(most, 1.0 - noise.col(k).squaredNorm() / left.col(k).squaredNorm());
    }
    EXPECT_NEAR(most, 0.5, 0.1) << c.effect;
  }
}

}  // namespace
}  // namespace odmc
