// What the regression fits beyond coefficients: where the ground is, how long a cable is, on which
// side mass was added; and what of it the published sigma holds.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "odmc/analysis/flight_motion.h"
#include "odmc/attribution/attribution.h"
#include "odmc/attribution/candidates.h"
#include "odmc/attribution/evidence.h"
#include "odmc/attribution/instruments.h"
#include "odmc/attribution/online_evidence.h"
#include "odmc/attribution/setting_profile.h"
#include "odmc/bench/undeclared.h"

namespace odmc {
namespace {

/// A flight with one undeclared effect, and what attribution needs of it.
struct Flown {
  Flown(const std::string& effect, double share, const std::string& trajectory, int vehicle,
        int seed, double raised_m = 0.0)
      : made(Raised(Make(effect, share, trajectory, vehicle, seed), raised_m)),
        flight(FilterFlight(made.log, made.declared.num_rotors(), {}), BlockSplit(),
               made.declared.odometry.q_BS.toRotationMatrix()),
        residual(&flight, &made.declared, true),
        candidates(CandidatesFor(made.declared, flight.motion())) {}

  static UndeclaredFlight Make(const std::string& effect, double share,
                               const std::string& trajectory, int vehicle, int seed) {
    UndeclaredPlan plan;
    plan.kind = UndeclaredKind::kOneEffect;
    plan.effects = {effect};
    plan.share = share;
    plan.trajectory = trajectory;
    plan.vehicle = vehicle;
    plan.seed = seed;
    return MakeUndeclared(plan);
  }

  /// The same in a world whose origin is lower.
  static UndeclaredFlight Raised(UndeclaredFlight made, double by_m) {
    for (OdometrySample& sample : made.log.odometry) sample.p_WS.z() += by_m;
    for (ParameterEstimate& p : made.truth.parameters) {
      if (p.full_name == "ground_effect.z_0") p.value += by_m;
    }
    return made;
  }

  ModelPoint point() const {
    const DynamicModel model(made.declared, made.declared.effects);
    return ModelPointOf(model, model.InitialValues());
  }
  /// With the true values of what is declared.
  ModelPoint TruePoint() const {
    ModelPoint point = this->point();
    for (auto& [name, value] : point.values) {
      if (const ParameterEstimate* p = made.truth.Find(name)) value = p->value;
    }
    return point;
  }
  Attribution Attribute() const {
    Attribution attribution(&residual, point(), candidates, {});
    attribution.Run();
    return attribution;
  }
  double Truth(const std::string& name) const { return made.truth.Find(name)->value; }

  UndeclaredFlight made;
  ThinnedFlight flight;
  ResidualModel residual;
  std::vector<EffectCandidate> candidates;
};

/// The effect as attribution has it, if it is named.
const RankedEffect* Named(const Attribution& attribution, const std::string& effect) {
  for (const RankedEffect& e : attribution.effects()) {
    if (e.name == effect) return &e;
  }
  return nullptr;
}

/// Error of a parameter over its sigma, what its settings and another valley leave open included.
double Sigmas(const RankedEffect& effect, const std::string& name, double truth) {
  const ParameterEstimate* p = effect.Find(name);
  double variance = p->sigma * p->sigma;
  for (size_t k = 0; k < effect.spread_of.size(); ++k) {
    const auto at = static_cast<Eigen::Index>(k);
    if (effect.spread_of[k] == name) variance = std::max(variance, effect.spread(at, at));
  }
  return (p->value - truth) / std::sqrt(variance);
}

TEST(FittedSettings, CableIsFittedBetweenTheLengthsTried) {
  for (const int seed : {4101, 4102}) {
    const Flown flown("suspended_load", 0.5, "aggressive", 0, seed);
    const Attribution attribution = flown.Attribute();
    const RankedEffect* load = Named(attribution, "suspended_load");
    ASSERT_NE(load, nullptr) << seed;
    const double length = flown.Truth("suspended_load.length");
    // Lengths are tried 15 % apart.
    EXPECT_NEAR(load->Find("suspended_load.length")->value, length, 0.03 * length) << seed;
    EXPECT_LT(load->Find("suspended_load.length")->sigma, 0.03 * length) << seed;
    EXPECT_LT(std::abs(Sigmas(*load, "suspended_load.length", length)), 3.0) << seed;
    EXPECT_TRUE(load->settings.count("suspended_load.length")) << "the online model holds it";
  }
}

TEST(FittedSettings, GroundIsFoundWithItsSigma) {
  double squares = 0.0, radius = 0.0;
  for (int seed = 4201; seed <= 4204; ++seed) {
    const Flown flown("ground_effect", 0.6, "vertical", 0, seed, seed % 2 > 0 ? 0.0 : 450.0);
    const Attribution attribution = flown.Attribute();
    const RankedEffect* ground = Named(attribution, "ground_effect");
    ASSERT_NE(ground, nullptr) << seed;
    radius = flown.made.declared.rotors.front().radius_m;
    squares += std::pow(ground->Find("ground_effect.z_0")->sigma, 2) / 4.0;
    for (const std::string name : {"ground_effect.k_ge", "ground_effect.z_0"}) {
      EXPECT_LT(std::abs(Sigmas(*ground, name, flown.Truth(name))), 3.0) << name << " " << seed;
    }
  }
  EXPECT_LT(std::sqrt(squares), 0.5 * radius);
}

// From wherever a fit began: it stops in the nearest valley.
TEST(FittedSettings, ProfileKnowsTheGroundFromAnyStart) {
  double squares = 0.0, flights = 0.0;
  for (const std::string trajectory : {"octo", "vertical"}) {
    for (int seed = 4601; seed <= 4608; ++seed) {
      const Flown flown("ground_effect", 0.1, trajectory, seed % 4, seed);
      const Instruments instruments(flown.flight, flown.made.declared);
      Evidence evidence({{&flown.residual, &instruments}}, flown.TruePoint());
      std::vector<int> starts;
      for (const EffectCandidate& c : flown.candidates) {
        if (c.effect == "ground_effect") starts.push_back(evidence.Add(c));
      }
      evidence.EstimateNoise();
      ASSERT_EQ(starts.size(), 2u);
      const auto profile = SettingProfile::Of(evidence, starts.front(), {starts.front()});
      ASSERT_TRUE(profile) << seed;
      const double truth = flown.Truth(profile->setting());
      const double sigmas = (profile->mean() - truth) / profile->sigma();
      EXPECT_LT(std::abs(sigmas), 3.5) << trajectory << " " << seed;
      squares += sigmas * sigmas;
      flights += 1.0;
      const auto other = SettingProfile::Of(evidence, starts.back(), {starts.back()});
      EXPECT_NEAR(profile->mean(), other->mean(), 0.1 * profile->sigma()) << seed;
      // As if normal, of all between the bounds.
      double from = 1e9, to = -1e9;
      for (const int v : starts) {
        const auto& bounds =
            evidence.variants()[static_cast<size_t>(v)].candidate.bounds.at(profile->setting());
        from = std::min(from, bounds.first);
        to = std::max(to, bounds.second);
      }
      EXPECT_LE(profile->log_occam(), 0.0);
      EXPECT_NEAR(profile->log_occam(), std::log(2.5 * profile->sigma() / (to - from)), 1.0);
    }
  }
  // So lies the mean of 16 squared normal numbers in 99 of 100 cases.
  EXPECT_GT(squares / flights, 0.32);
  EXPECT_LT(squares / flights, 2.15);
}

TEST(FittedSettings, ProfileIsOfOneFittedSettingOnly) {
  const Flown flown("suspended_load", 0.5, "aggressive", 0, 4101);
  const Instruments instruments(flown.flight, flown.made.declared);
  Evidence evidence({{&flown.residual, &instruments}}, flown.TruePoint());
  for (const EffectCandidate& c : flown.candidates) {
    if (c.effect != "suspended_load" && c.effect != "wind") continue;
    const int v = evidence.Add(c);
    evidence.EstimateNoise();
    EXPECT_FALSE(SettingProfile::Of(evidence, v, {v})) << c.effect;
    if (c.effect == "wind") break;
  }
}

/// What the mass's sigma has from the valley on the other side.
double OtherSide(const RankedEffect& effect) {
  const auto at = std::find(effect.spread_of.begin(), effect.spread_of.end(), "mass_change.mass") -
                  effect.spread_of.begin();
  return std::sqrt(effect.spread(at, at));
}

// A load whose moment shows, and hardly its weight: more mass here is less mass there.
TEST(FittedSettings, GroundIsWhereTheVehicleStood) {
  const Flown flown("ground_effect", 0.3, "vertical", 0, 11);
  const double radius = flown.made.declared.rotors.front().radius_m;
  FlightMotion motion = flown.flight.motion();
  const auto grounds = [&] {
    std::vector<double> starts;
    for (const EffectCandidate& c : CandidatesFor(flown.made.declared, motion)) {
      if (c.effect == "ground_effect") starts.push_back(c.start.at("ground_effect.z_0"));
    }
    return starts;
  };
  EXPECT_EQ(grounds().size(), 2u);
  motion.stood_z_m = 0.4;
  EXPECT_EQ(grounds(), (std::vector<double>{0.4, 0.4 - 2.0 * radius}));
}

TEST(FittedSettings, GroundThatTakesThrustAwayLosesItsScore) {
  const Flown flown("ground_effect", 0.3, "vertical", 0, 11);
  const auto effect = EffectRegistry::Default().Make("ground_effect", flown.made.declared);
  const ParameterSpec& k_ge = effect->parameters().front();
  ASSERT_EQ(k_ge.name, "k_ge");
  EXPECT_LT(LogSignOdds(k_ge.sign, k_ge.certain_sign, -5.0, 1.0), -12.0);
  EXPECT_GT(LogSignOdds(k_ge.sign, k_ge.certain_sign, 5.0, 1.0), 0.0);
}

TEST(FittedSettings, SigmaHoldsBothSidesOnWhichAMassMayBe) {
  int named = 0, on_either_side = 0;
  for (const int seed : {4301, 4302, 4303, 4304}) {
    const Flown flown("mass_change", 0.1, "octo", 3, seed);
    const Attribution attribution = flown.Attribute();
    const RankedEffect* mass = Named(attribution, "mass_change");
    if (mass == nullptr) continue;
    ++named;
    on_either_side += OtherSide(*mass) > 0.3 * std::abs(mass->Find("mass_change.mass")->value);
    for (const std::string name : {"mass_change.mass", "mass_change.x", "mass_change.y"}) {
      EXPECT_LT(std::abs(Sigmas(*mass, name, flown.Truth(name))), 3.0) << name << " " << seed;
    }
  }
  EXPECT_GE(named, 2);
  EXPECT_GE(on_either_side, 1);
}

// The step of what waits for a size is worth s0/s: without that, linearizing again oscillates.
TEST(Evidence, LinearizesAProductAgainWithoutOvershooting) {
  const Flown flown("suspended_load", 0.7, "octo", 2, 4401);
  const Instruments instruments(flown.flight, flown.made.declared);
  Evidence evidence({{&flown.residual, &instruments}}, flown.point());
  EffectCandidate candidate;
  candidate.effect = "suspended_load";
  candidate.size = "suspended_load.mass";
  candidate.start = {{candidate.size, 0.05 * flown.made.declared.mass_kg}};
  for (const std::string name : {"suspended_load.length", "suspended_load.damping"}) {
    candidate.settings[name] = flown.Truth(name);
  }
  const int v = evidence.Add(candidate);
  evidence.EstimateNoise();
  double gain = evidence.GainInNats({v});
  for (int round = 0; round < 4; ++round) {
    evidence.Relinearize({{v, evidence.FoundBy(evidence.Solve({v}), v)}});
    evidence.EstimateNoise();
    const double next = evidence.GainInNats({v});
    EXPECT_GT(next, 0.8 * gain) << round;
    gain = next;
  }
  const EffectFit fit = evidence.Solve({v});
  EXPECT_LT(evidence.StepInSigmas(v, fit), 0.5);
  for (size_t k = 0; k < fit.columns.size(); ++k) {
    if (evidence.column(fit.columns[k]).name != candidate.size) continue;
    const auto at = static_cast<Eigen::Index>(k);
    EXPECT_NEAR(fit.coefficients[at], flown.Truth(candidate.size),
                4.0 * std::sqrt(fit.covariance(at, at)));
  }
}

/// The evidence for one way to act, linearized at its start.
struct Started {
  Started(const Flown& flown, const EffectCandidate& candidate)
      : instruments(flown.flight, flown.made.declared),
        evidence({{&flown.residual, &instruments}}, flown.TruePoint()),
        variant(evidence.Add(candidate)) {
    evidence.EstimateNoise();
    evidence.Relinearize({{variant, {candidate.start}}});
    evidence.EstimateNoise();
  }
  double Gain() const { return evidence.GainInNats({variant}); }
  double GainWhereLinearized() const {
    return evidence.LogEvidenceWhereLinearized(variant) - evidence.Solve({}).log_evidence;
  }

  Instruments instruments;
  Evidence evidence;
  int variant;
};

/// A small mass lost far outside: it turns the inertia over, and the wrench is no linear function
/// of its place there.
EffectCandidate MassLostFarOutside(const Vehicle& vehicle, double arms) {
  EffectCandidate candidate;
  candidate.effect = "mass_change";
  candidate.size = "mass_change.mass";
  candidate.settings = {{"mass_change.from", 0.0}};
  candidate.bounds = {{candidate.size, {-0.9 * vehicle.mass_kg, -1e-3 * vehicle.mass_kg}}};
  const double out = arms * vehicle.ArmLength();
  candidate.start = {{candidate.size, -0.01 * vehicle.mass_kg},
                     {"mass_change.x", out},
                     {"mass_change.y", 0.0},
                     {"mass_change.z", out}};
  return candidate;
}

TEST(Evidence, KnowsWhatTheModelDoesWhereItIsLinearized) {
  const Flown flown("products_of_inertia", 0.7, "aggressive", 2, 4501);
  EffectCandidate candidate;
  candidate.effect = "products_of_inertia";
  for (const std::string axes : {"xy", "xz", "yz"}) {
    const std::string name = candidate.effect + "." + axes;
    candidate.start[name] = flown.Truth(name);
  }
  const Started right(flown, candidate);
  EXPECT_GT(right.Gain(), 100.0);
  EXPECT_GT(right.GainWhereLinearized(), right.Gain());  // nothing is unknown there
  EXPECT_LT(right.GainWhereLinearized(), right.Gain() + 30.0);
  for (auto& value : candidate.start) value.second *= -1.0;
  const Started wrong(flown, candidate);
  EXPECT_GT(wrong.Gain(), 100.0);
  EXPECT_LT(wrong.GainWhereLinearized(), -100.0);
}

TEST(FittedSettings, StepsThatTheModelDoesNotBearOutAreTakenBack) {
  const Flown flown("products_of_inertia", 0.7, "aggressive", 2, 4501);
  for (const double arms : {1.0, 4.0}) {
    const EffectCandidate candidate = MassLostFarOutside(flown.made.declared, arms);
    const Started started(flown, candidate);
    EXPECT_GT(started.Gain(), started.GainWhereLinearized() + 100.0) << arms;
    Attribution attribution(&flown.residual, flown.point(),
                            {candidate, {"products_of_inertia", {}, {}}}, {});
    attribution.Run();
    // As a load outside it turns the axes of inertia, too.
    for (const RankedEffect& effect : attribution.ranking()) {
      EXPECT_GT(effect.score, 50.0) << effect.name << " " << arms;
    }
    EXPECT_NE(Named(attribution, "products_of_inertia"), nullptr) << arms;
  }
}

TEST(AddSpread, WidensWhatIsEstimatedAndNothingElse) {
  ParameterSet online;
  online.parameters = {{"a", "1", 1.0, 0.3, true, true}, {"b", "1", 2.0, 0.0, false, false}};
  online.covariance = Eigen::MatrixXd::Zero(2, 2);
  online.covariance(0, 0) = 0.09;
  RankedEffect effect;
  effect.spread_of = {"b", "a", "elsewhere"};
  effect.spread = Eigen::Vector3d(1.0, 0.16, 4.0).asDiagonal();
  AddSpread(effect, &online);
  EXPECT_NEAR(online.parameters[0].sigma, 0.5, 1e-12);
  EXPECT_NEAR(online.covariance(0, 0), 0.25, 1e-12);
  EXPECT_EQ(online.parameters[1].sigma, 0.0);
  EXPECT_EQ(online.covariance(1, 1), 0.0);
}

}  // namespace
}  // namespace odmc
