// What an online estimate says of an effect, and what errors of the streams leave of it.
#include <gtest/gtest.h>

#include "odmc/attribution/close_loop.h"
#include "odmc/attribution/online_evidence.h"
#include "odmc/attribution/online_pass.h"
#include "odmc/model/dynamic_model.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace test {
namespace {

/// An online estimate of quadratic drag (one size) and a change of mass (one size, a place).
class OnlineEvidence : public ::testing::Test {
 protected:
  OnlineEvidence() : vehicle_(WithEffects()), model_(vehicle_, vehicle_.effects), changes_(Zero()) {
    for (const ModelParameter& p : model_.parameters()) {
      ParameterEstimate estimate;
      estimate.full_name = p.full_name;
      estimate.estimated = true;
      estimate.sigma = 1.0;
      online_.parameters.push_back(estimate);
    }
    online_.covariance =
        Eigen::MatrixXd::Identity(model_.num_parameters(), model_.num_parameters());
  }

  static Vehicle WithEffects() {
    Vehicle vehicle = NominalVehicle();
    vehicle.effects.insert(vehicle.effects.end(), {"quadratic_drag", "mass_change"});
    return vehicle;
  }
  Eigen::VectorXd Zero() const { return Eigen::VectorXd::Zero(model_.num_parameters()); }
  RankedEffect Effect(const std::string& name) const {
    RankedEffect effect;
    effect.name = name;
    for (const ParameterEstimate& p : online_.parameters) {
      if (p.full_name.compare(0, name.size() + 1, name + ".") == 0) effect.parameters.push_back(p);
    }
    return effect;
  }
  void Set(const std::string& name, double value) {
    online_.parameters[static_cast<size_t>(model_.IndexOf(name))].value = value;
  }
  bool SizeMayBeZero(const std::string& effect) const {
    return odmc::SizeMayBeZero(Effect(effect), online_, changes_, model_, options_);
  }

  const Vehicle vehicle_;
  const DynamicModel model_;
  const AttributionOptions options_;
  ParameterSet online_;
  Eigen::VectorXd changes_;
};

TEST_F(OnlineEvidence, MayBeZeroWhereAnErrorOfEitherSignBringsItThere) {
  const int c_q = model_.IndexOf("quadratic_drag.c_q");
  Set("quadratic_drag.c_q", 10.0);
  const double sigmas = options_.significant_sigmas;
  EXPECT_TRUE(SizeDiffersFromZero(Effect("quadratic_drag"), online_, model_, sigmas));
  EXPECT_FALSE(SizeMayBeZero("quadratic_drag")) << "no error changes it";
  for (const double error : {-9.0, 9.0, 40.0}) {
    changes_[c_q] = error;
    EXPECT_TRUE(SizeMayBeZero("quadratic_drag")) << error;
  }
  changes_[c_q] = 5.0;
  EXPECT_FALSE(SizeMayBeZero("quadratic_drag")) << "five sigma are left";
  changes_ = Zero();
  changes_[model_.IndexOf("thrust.k_f")] = 100.0;
  EXPECT_FALSE(SizeMayBeZero("quadratic_drag")) << "another effect's";
}

TEST_F(OnlineEvidence, ASizeWithinOneSigmaIsNone) {
  Set("mass_change.mass", -0.16);
  Set("mass_change.x", 40.0);  // a place is no size
  online_.covariance(model_.IndexOf("mass_change.mass"), model_.IndexOf("mass_change.mass")) = 0.13;
  EXPECT_FALSE(SizeDiffersFromZero(Effect("mass_change"), online_, model_, 1.0));
  // What the online estimator does not see is a part of sigma.
  Set("mass_change.mass", 0.5);
  EXPECT_TRUE(SizeDiffersFromZero(Effect("mass_change"), online_, model_, 1.0));
  RankedEffect spread = Effect("mass_change");
  spread.spread_of = {"mass_change.mass"};
  spread.spread = Eigen::MatrixXd::Constant(1, 1, 0.25);
  AddSpread(spread, &online_);
  EXPECT_FALSE(SizeDiffersFromZero(Effect("mass_change"), online_, model_, 1.0));
}

TEST_F(OnlineEvidence, AMassMayBeZeroWhateverItsPlace) {
  Set("mass_change.mass", 10.0);
  Set("mass_change.z", -3.0);
  changes_[model_.IndexOf("mass_change.z")] = 3.0;
  EXPECT_FALSE(SizeMayBeZero("mass_change"));
  changes_[model_.IndexOf("mass_change.mass")] = -10.0;
  EXPECT_TRUE(SizeMayBeZero("mass_change"));
}

// An estimate that only says little gives way to the fit; one that says something else has to
// predict worse for that.
TEST(OnlinePass, KeepsToTheFitUnlessThatPredictsWorse) {
  const AttributionOptions options;
  const auto errors = [](double factor) {
    PredictionFigures figures;
    figures.force_rmse_N = factor * Eigen::Vector3d(0.1, 0.2, 0.3);
    figures.angular_acceleration_rmse_rad_s2 = factor * Eigen::Vector3d(1.0, 2.0, 3.0);
    return figures;
  };
  const auto takes = [&](double factor, bool contradicts) {
    return TakesPlace(errors(factor), errors(1.0), contradicts, options);
  };
  const double as_good = 1.0 + 0.5 * (1.0 - options.least_ratio);
  EXPECT_TRUE(takes(as_good, false));
  EXPECT_FALSE(takes(as_good, true));
  EXPECT_TRUE(takes(0.999, true));
  EXPECT_FALSE(takes(1.01 / options.least_ratio, false));
}

TEST(SecondLook, CountsWhereItNamesAnEffectAndPredictsBetter) {
  const auto look = [](const std::string& effect, double error) {
    ClosedLoop loop;
    if (!effect.empty()) loop.effects.emplace_back().effect.name = effect;
    loop.after.force_rmse_N = error * Eigen::Vector3d(0.1, 0.2, 0.3);
    return loop;
  };
  ClosedLoop first = look("rotor_tilt", 1.0);
  first.denied = {"mass_change"};
  const ClosedLoop better = BetterLook(first, look("products_of_inertia", 0.9));
  ASSERT_EQ(better.effects.size(), 1U);
  EXPECT_EQ(better.effects.front().effect.name, "products_of_inertia");
  ASSERT_EQ(better.warnings.size(), 1U);
  EXPECT_NE(better.warnings.front().find("mass_change"), std::string::npos);
  EXPECT_EQ(BetterLook(first, look("wind", 1.1)).effects.front().effect.name, "rotor_tilt");
  EXPECT_TRUE(BetterLook(first, look("wind", 1.1)).warnings.empty());
  EXPECT_EQ(BetterLook(first, look("", 0.9)).effects.front().effect.name, "rotor_tilt");
}

TEST(OnlinePass, IsRuinedByAnAxisOnlyIfAllTogetherAreWorse) {
  const AttributionOptions options;
  const auto errors = [](double force, double yaw) {
    PredictionFigures figures;
    figures.force_rmse_N = force * Eigen::Vector3d(0.1, 0.2, 0.3);
    figures.torque_rmse_Nm = Eigen::Vector3d(0.01, 0.02, 0.03 * yaw);
    figures.angular_acceleration_rmse_rad_s2 = Eigen::Vector3d(1.0, 2.0, 3.0 * yaw);
    return figures;
  };
  const PredictionFigures without = errors(1.0, 1.0);
  EXPECT_FALSE(Ruins(without, without, options));
  EXPECT_FALSE(Ruins(without, errors(1.0, 1.9), options));
  EXPECT_TRUE(Ruins(without, errors(1.0, 2.1), options));
  EXPECT_TRUE(Ruins(without, errors(0.8, 2.1), options));   // 3 ln 0.8 + ln 2.1 > 0
  EXPECT_FALSE(Ruins(without, errors(0.7, 2.1), options));  // < 0
}

}  // namespace
}  // namespace test
}  // namespace odmc
