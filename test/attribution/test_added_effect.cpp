// An effect from outside the package: one class and one line make it known everywhere.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <stdexcept>
#include <string>

#include "odmc/analysis/effect_catalogue.h"
#include "odmc/attribution/candidates.h"
#include "odmc/attribution/close_loop.h"
#include "odmc/attribution/close_loop_report.h"
#include "odmc/bench/undeclared.h"
#include "odmc/io/vehicle_yaml.h"
#include "odmc/math/so3.h"
#include "odmc/model/effect.h"

namespace odmc {
namespace test {
namespace {

constexpr char kName[] = "magnetic_moment";

/// A magnet on board in the Earth's field: couple m × R^T e1, m fixed in the body.
class MagneticMoment final : public Effect {
 public:
  explicit MagneticMoment(const Vehicle& vehicle)
      : Effect(vehicle,
               {kName, "Magnetic moment", "couple m x R_WB^T e1", "this test", "a level field"},
               {Axis("m_x", vehicle), Axis("m_y", vehicle), Axis("m_z", vehicle)}) {}

 private:
  static ParameterSpec Axis(const std::string& name, const Vehicle& vehicle) {
    const double size = 0.01 * vehicle.mass_kg * vehicle.gravity_m_s2 * vehicle.ArmLength();
    return {name, "N m", "moment times field, body " + name.substr(2), 0.0, size, size};
  }

  void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                   WrenchJacobians* J) const override {
    const Eigen::Vector3d field_B = state.R_WB.transpose() * Eigen::Vector3d::UnitX();
    const Eigen::Vector3d m = values.head<3>();
    wrench->AddCouple(m.cross(field_B));
    if (J == nullptr) return;
    J->AddCouple(kColumnAttitude, Hat(m) * Hat(field_B));
    for (int i = 0; i < 3; ++i) {
      J->AddCoupleParameter(i, Eigen::Vector3d::Unit(i).cross(field_B));
    }
  }
};

std::unique_ptr<Effect> MakeMagneticMoment(const Vehicle& vehicle) {
  return std::make_unique<MagneticMoment>(vehicle);
}

bool IsPlanned(const std::string& name, UndeclaredKind kind) {
  const std::vector<UndeclaredPlan> plans = PlanUndeclared(1, 160);
  return std::any_of(plans.begin(), plans.end(), [&](const UndeclaredPlan& plan) {
    return plan.kind == kind && std::count(plan.effects.begin(), plan.effects.end(), name) > 0;
  });
}

class AddedEffect : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    if (!EffectRegistry::Default().Has(kName)) EffectRegistry::Extend(kName, MakeMagneticMoment);
  }
};

TEST_F(AddedEffect, ANameCannotBeTakenTwice) {
  EXPECT_THROW(EffectRegistry::Extend("drag", MakeMagneticMoment), std::invalid_argument);
}

TEST_F(AddedEffect, AVehicleFileMayNameIt) {
  Vehicle vehicle = UndeclaredVehicles().front();
  vehicle.effects.push_back(kName);
  EXPECT_EQ(ParseVehicle(FormatVehicle(vehicle), "test").effects, vehicle.effects);
}

TEST_F(AddedEffect, TheCatalogueDescribesIt) {
  const Vehicle vehicle = UndeclaredVehicles().front();
  for (const std::string& text : {CatalogueText(vehicle), CatalogueMarkdown(vehicle)}) {
    EXPECT_NE(text.find("couple m x R_WB^T e1"), std::string::npos);
    EXPECT_NE(text.find("magnetic_moment.m_z"), std::string::npos);
  }
}

TEST_F(AddedEffect, TestFlightsArePlannedWithIt) {
  EXPECT_TRUE(IsPlanned(kName, UndeclaredKind::kOneEffect));
  EXPECT_FALSE(IsPlanned("rotor_level", UndeclaredKind::kOneEffect));
}

TEST_F(AddedEffect, AttributionFindsItOnASimulatedFlight) {
  UndeclaredPlan plan;
  plan.kind = UndeclaredKind::kOneEffect;
  plan.effects = {kName};
  plan.strength = "strong";
  plan.share = 0.8;
  plan.trajectory = "octo";
  plan.seed = 41;
  const UndeclaredFlight flight = MakeUndeclared(plan);
  EXPECT_EQ(flight.right_answer, "effect");
  EXPECT_GT(flight.share, 0.5);

  const FlightMotion motion = FilterFlight(flight.log, flight.declared.num_rotors(), {});
  const std::vector<EffectCandidate> candidates = CandidatesFor(flight.declared, motion);
  EXPECT_EQ(std::count_if(candidates.begin(), candidates.end(),
                          [](const EffectCandidate& c) { return c.effect == kName; }),
            1);

  CloseLoopOptions options;
  options.estimator.keyframe_rate_hz = 50.0;
  const ClosedLoop loop = CloseLoop(flight.log, flight.declared, flight.declared, options);
  ASSERT_EQ(loop.verdict, Verdict::kEffect) << CloseLoopTable(loop);
  EXPECT_EQ(loop.effects.front().effect.name, kName) << CloseLoopTable(loop);
  for (const char* name : {"magnetic_moment.m_x", "magnetic_moment.m_y", "magnetic_moment.m_z"}) {
    const ParameterEstimate* truth = flight.truth.Find(name);
    const ParameterEstimate* found = loop.parameters.Find(name);
    ASSERT_TRUE(truth != nullptr && found != nullptr) << name;
    EXPECT_NEAR(found->value, truth->value, 4.0 * found->sigma + 0.1 * std::abs(truth->value))
        << name;
  }
}

}  // namespace
}  // namespace test
}  // namespace odmc
