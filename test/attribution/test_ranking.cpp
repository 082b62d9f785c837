// What a flight can tell at all, and the fit of the declared model.

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "odmc/analysis/flight_motion.h"
#include "odmc/analysis/model_choice.h"
#include "odmc/attribution/candidates.h"
#include "odmc/attribution/close_loop.h"
#include "odmc/attribution/ranking.h"
#include "odmc/attribution/undeclared.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"

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

/// A flight on which one effect makes up `share` of the residual, none where it is empty.
UndeclaredFlight Make(const std::string& effect, double share, const std::string& trajectory,
                      int vehicle, int seed) {
  UndeclaredPlan plan;
  plan.kind = effect.empty() ? Undeclared::kNothing : Undeclared::kOneEffect;
  if (!effect.empty()) plan.effects = {effect};
  plan.share = share;
  plan.trajectory = trajectory;
  plan.vehicle = vehicle;
  plan.seed = seed;
  return MakeUndeclared(plan);
}

/// A flight in which nothing acts that the model lacks.
Flown Fly(const std::string& trajectory) { return Filtered(Make("", 0.0, trajectory, 0, 31)); }

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

TEST(AreTooLargeTogether, IsAsSevereAsOnASingleCoefficient) {
  EXPECT_FALSE(AreTooLargeTogether({3.9}));
  EXPECT_TRUE(AreTooLargeTogether({-4.1}));
  EXPECT_FALSE(AreTooLargeTogether(std::vector<double>(8, 1.9)));
  EXPECT_TRUE(AreTooLargeTogether(std::vector<double>(8, -2.0)));
  EXPECT_FALSE(AreTooLargeTogether({}));
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
  const UndeclaredFlight flight = Make("", 0.0, "vertical", 2, 31008);
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
// Derivatives of measured speeds are mostly noise where the filter still lets them through; as a
// regressor as they are, they halve the coefficient.
TEST(Regressor, FindsWhatTakesRotorAccelerationsThroughTheirNoise) {
  for (const std::string effect : {"rotor_delay", "rotor_reaction"}) {
    const UndeclaredFlight flight = Make(effect, 0.5, "octo", 3, 31131);
    const Flown flown = Filtered(flight);
    const ResidualModel residual(&flown.flight, &flown.vehicle, true);
    Stage stage = DeclaredStage(flown.vehicle, flight.truth, residual);
    const Regressor regressor(&residual, &stage);
    const Regressor::Result result = regressor.FitWith(stage, {Candidate{effect, {}, {}}});
    const std::string name = effect + (effect == "rotor_delay" ? ".delay" : ".J_r");
    const double truth = flight.truth.Find(name)->value;
    EXPECT_NEAR(result.values.at(name), truth, 0.25 * truth) << name;
  }
}

/// A flight of the declared model with other effects at given values, and the true values.
struct WithEffects {
  Flown flown;
  ParameterSet truth;
};

WithEffects FlyWith(const std::vector<std::string>& effects,
                    const std::map<std::string, double>& given) {
  const Vehicle declared = UndeclaredVehicles()[0];
  Vehicle whole = declared;
  whole.effects.insert(whole.effects.end(), effects.begin(), effects.end());
  const DynamicModel model(whole, whole.effects);
  ModelValues truth = DefaultTruth(model);
  for (const auto& [name, value] : given) truth[model.IndexOf(name)] = value;
  SimulationOptions options;
  options.trajectory = "aggressive";
  options.duration_s = 24.0;
  options.seed = 5;
  const FlightLog log = Simulate(model, truth, options, SimulationNoise()).log;
  return {{declared, ThinnedFlight(FilterFlight(log, declared.num_rotors(), {}), BlockSplit())},
          ExactParameters(model, truth)};
}

/// What the pairs of some candidates come to on a flight.
std::optional<Pair> BestPair(const WithEffects& flight, const std::vector<std::string>& effects,
                             std::vector<Tried>* tried) {
  const Vehicle& vehicle = flight.flown.vehicle;
  const ResidualModel residual(&flight.flown.flight, &vehicle, true);
  Stage stage = DeclaredStage(vehicle, flight.truth, residual);
  const Regressor regressor(&residual, &stage);
  std::vector<Candidate> candidates;
  for (const std::string& effect : effects) candidates.push_back({effect, {}, {}});
  const WrenchFit& base = regressor.base().fit;
  *tried = TryAll(stage, candidates, regressor, base, kNumChannels);
  return TryPairs(stage, *tried, regressor, base, kNumChannels, 10.0);
}

// The hubs pitch the body up and a low centre of pressure pitches it down: in hover's rotor speed
// they cancel, and each alone explains next to nothing of the rest.
TEST(TryPairs, FindsTwoEffectsThatOnlyHelpTogether) {
  const std::vector<std::string> both = {"hub_moment", "pressure_centre"};
  const Vehicle vehicle = UndeclaredVehicles()[0];
  const double hover = std::sqrt(vehicle.mass_kg * vehicle.gravity_m_s2 / 4.0 /
                                 *vehicle.parameters.at("thrust.k_f").value);
  const double k_beta = 1.2e-5, drag = 0.28;
  const WithEffects flight = FlyWith(both, {{"drag.d_x", -drag},
                                            {"drag.d_y", -drag},
                                            {"hub_moment.k_beta", k_beta},
                                            {"pressure_centre.z", -k_beta * 4.0 * hover / drag}});
  std::vector<Tried> tried;
  const std::optional<Pair> pair =
      BestPair(flight, {"hub_moment", "pressure_centre", "quadratic_drag", "rotor_tilt"}, &tried);
  ASSERT_TRUE(pair.has_value());
  for (const std::string& effect : both) {
    EXPECT_TRUE(pair->ranked[0].name == effect || pair->ranked[1].name == effect) << effect;
  }
  for (const Tried& t : tried) EXPECT_LT(t.ranked.score, 0.5 * pair->score) << t.ranked.name;
  for (const RankedEffect& ranked : pair->ranked) {
    EXPECT_TRUE(ranked.sound) << ranked.name << ": " << ranked.objection;
    for (const ParameterEstimate& p : ranked.parameters) {
      if (p.full_name != "hub_moment.k_beta" && p.full_name != "pressure_centre.z") continue;
      const double truth = flight.truth.Find(p.full_name)->value;
      EXPECT_NEAR(p.value, truth, 0.3 * std::abs(truth)) << p.full_name;
    }
  }
}

TEST(TryPairs, MakesNoPairOfAnEffectAndItsShadow) {
  const WithEffects flight = FlyWith({"quadratic_drag"}, {{"quadratic_drag.c_q", 0.02}});
  std::vector<Tried> tried;
  EXPECT_FALSE(BestPair(flight, {"quadratic_drag", "rotor_drag", "hub_moment"}, &tried));
  ASSERT_FALSE(tried.empty());
  EXPECT_EQ(tried.front().ranked.name, "quadratic_drag");
}

TEST(IsSpecialCase, KnowsIsotropyWhereTheEstimateAllowsIt) {
  const auto judge = [](const std::string& effect, const std::map<std::string, double>& given,
                        const std::string& special) {
    const WithEffects flight = FlyWith({effect}, given);
    std::vector<Tried> tried;
    BestPair(flight, {"hub_moment", "anisotropic_hub_moment", "quadratic_drag"}, &tried);
    const auto find = [&](const std::string& name) -> const Tried& {
      return *std::find_if(tried.begin(), tried.end(),
                           [&](const Tried& t) { return t.ranked.name == name; });
    };
    return IsSpecialCase(find(special), find("anisotropic_hub_moment"));
  };
  EXPECT_TRUE(judge("hub_moment", {{"hub_moment.k_beta", 4e-6}}, "hub_moment"));
  EXPECT_FALSE(judge("anisotropic_hub_moment",
                     {{"anisotropic_hub_moment.k_bx", 2e-6}, {"anisotropic_hub_moment.k_by", 6e-6}},
                     "hub_moment"));
  // Another effect, however few its parameters.
  EXPECT_FALSE(judge("hub_moment", {{"hub_moment.k_beta", 4e-6}}, "quadratic_drag"));
}

TEST(MakeUndeclared, SharesAreWhatTheDeclaredModelLeaves) {
  struct Case {
    const char *effect, *trajectory;
    int vehicle;
  };
  for (const Case& c : {Case{"rotor_asymmetry", "octo", 1}, Case{"hub_moment", "circle", 2},
                        Case{"quadratic_drag", "aggressive", 0}}) {
    const UndeclaredFlight flight = Make(c.effect, 0.5, c.trajectory, c.vehicle, 31075);
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

// Flight 99 of seed 41: no sensible size of it shows a third of the residual on any trajectory.
TEST(MakeUndeclared, CallsWhatShowsLessThanPlannedByItsRealStrength) {
  const UndeclaredFlight flight = Make("anisotropic_hvt", 0.3, "octo", 3, 41099);
  EXPECT_LT(flight.share, 0.1);
  EXPECT_EQ(flight.plan.strength, "weak");
  EXPECT_EQ(flight.plan.share, 0.08);
}

}  // namespace
}  // namespace odmc
