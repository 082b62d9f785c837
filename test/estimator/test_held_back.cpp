#include <gtest/gtest.h>

#include <cmath>

#include "odmc/estimator/acceptance.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace {

// An estimate in which everything is sure, until the test spoils it.
class HeldBackTest : public ::testing::Test {
 protected:
  HeldBackTest() : model_(test::NominalVehicle(), test::PaperEffects()) {
    snapshot_.values = DefaultTruth(model_);
    snapshot_.body = model_.Properties(snapshot_.values);
    snapshot_.observable.assign(model_.num_parameters(), true);
    snapshot_.sigma = 0.01 * snapshot_.values.cwiseAbs();
    snapshot_.covariance = snapshot_.sigma.cwiseAbs2().asDiagonal();
  }

  int Index(const std::string& name) const { return model_.IndexOf(name); }

  void SetSigma(int i, double sigma) {
    snapshot_.sigma[i] = sigma;
    snapshot_.covariance(i, i) = sigma * sigma;
  }
  void Correlate(int i, int k, double correlation) {
    snapshot_.covariance(i, k) = snapshot_.covariance(k, i) =
        correlation * snapshot_.sigma[i] * snapshot_.sigma[k];
  }
  void Update() {
    snapshot_.stamp += FromSeconds(0.6);
    acceptance_.Update(model_, snapshot_);
  }

  DynamicModel model_;
  Snapshot snapshot_;
  Acceptance acceptance_{AcceptanceOptions()};
};

TEST_F(HeldBackTest, GivesTheEstimateItselfWhereAllIsSure) {
  Update();
  EXPECT_EQ(acceptance_.Usable().values, snapshot_.values);
  EXPECT_TRUE(acceptance_.held_back().empty());
}

TEST_F(HeldBackTest, OnlyAGoodEstimateIsAccepted) {
  for (int i = 0; i < 4; ++i) Update();
  EXPECT_TRUE(acceptance_.accepted());
  Finding remark;
  remark.what = "a remark";
  Finding doubt = remark;
  doubt.leaves = Trust::kDoubtful;
  doubt.what = "the thirds of the flight disagree";
  snapshot_.stamp += FromSeconds(0.6);
  EXPECT_TRUE(acceptance_.Update(model_, snapshot_, {remark}));
  snapshot_.stamp += FromSeconds(0.6);
  EXPECT_FALSE(acceptance_.Update(model_, snapshot_, {remark, doubt}));
  ASSERT_EQ(acceptance_.reasons().size(), 1u);
  EXPECT_EQ(acceptance_.reasons().front(), doubt.what);
}

TEST_F(HeldBackTest, AThrustCoefficientOfAnotherUnitIsNotAccepted) {
  for (int i = 0; i < 4; ++i) Update();
  EXPECT_TRUE(acceptance_.accepted());
  const int k_f = Index("thrust.k_f");
  snapshot_.values[k_f] *= 0.011;  // rotor speeds in rpm
  SetSigma(k_f, 0.001 * snapshot_.values[k_f]);
  Update();
  EXPECT_FALSE(acceptance_.accepted());
  ASSERT_EQ(acceptance_.reasons().size(), 1u);
  EXPECT_NE(acceptance_.reasons().front().find("check the unit of the rotor speeds"),
            std::string::npos);
}

// By hand: x | y = y0 has mean x + s_x ρ (y0 - y) / s_y and sigma s_x √(1 - ρ²).
TEST_F(HeldBackTest, ConditionsTheSureOnWhatKeepsItsPrior) {
  const int z = Index("centre_of_gravity.z"), d = Index("drag.d_x");
  constexpr double kSigma = 0.02, kCorrelation = 0.8;
  SetSigma(z, kSigma);
  Correlate(z, d, kCorrelation);
  for (int i = 0; i < 4; ++i) Update();
  EXPECT_TRUE(acceptance_.accepted());  // one weak parameter does not hold up the rest
  ASSERT_EQ(acceptance_.held_back().size(), 1u);
  EXPECT_NE(acceptance_.held_back().front().find("centre_of_gravity.z"), std::string::npos);

  const Snapshot& usable = acceptance_.Usable();
  const double prior = model_.parameters()[z].spec.prior_value;
  EXPECT_EQ(usable.values[z], prior);
  EXPECT_FALSE(usable.observable[z]);
  const double shift = kCorrelation * snapshot_.sigma[d] * (prior - snapshot_.values[z]) / kSigma;
  EXPECT_NEAR(usable.values[d], snapshot_.values[d] + shift, 1e-9);
  EXPECT_NEAR(usable.sigma[d], 0.6 * snapshot_.sigma[d], 1e-9);
  EXPECT_NEAR(usable.covariance(d, d), std::pow(usable.sigma[d], 2), 1e-12);
  EXPECT_EQ(usable.covariance(d, z), 0.0);
  const int k_f = Index("thrust.k_f");
  EXPECT_EQ(usable.values[k_f], snapshot_.values[k_f]);  // not correlated: not touched
}

TEST_F(HeldBackTest, HoldsBackACoefficientOfTheWrongSign) {
  const int d = Index("drag.d_y");
  snapshot_.values[d] *= -1.0;
  for (int i = 0; i < 4; ++i) Update();
  EXPECT_TRUE(acceptance_.accepted());
  EXPECT_EQ(acceptance_.Usable().values[d], model_.parameters()[d].spec.prior_value);
}

// Drag is sure and negative; given the prior value of the height, six sigma away, it is positive.
TEST_F(HeldBackTest, WhatBecomesUnphysicalBesideTheHeldBackIsHeldBackToo) {
  const int z = Index("centre_of_gravity.z"), d = Index("drag.d_x");
  SetSigma(z, 0.02);
  SetSigma(d, 0.2 * std::abs(snapshot_.values[d]));
  Correlate(z, d, 0.95);
  snapshot_.values[z] = model_.parameters()[z].spec.prior_value - 6.0 * snapshot_.sigma[z];
  for (int i = 0; i < 4; ++i) Update();
  EXPECT_TRUE(acceptance_.accepted());
  ASSERT_EQ(acceptance_.held_back().size(), 2u);
  EXPECT_NE(acceptance_.held_back().back().find("drag.d_x"), std::string::npos);
  EXPECT_EQ(acceptance_.Usable().values[d], model_.parameters()[d].spec.prior_value);
}

TEST_F(HeldBackTest, WhatWasSureOnceDoesNotComeAndGo) {
  const int d = Index("drag.d_x");
  const double limit =
      0.1 * std::max(model_.parameters()[d].spec.prior_sigma, model_.parameters()[d].spec.scale);
  SetSigma(d, 1.2 * limit);
  Update();
  EXPECT_EQ(acceptance_.held_back().size(), 1u);
  SetSigma(d, 0.9 * limit);
  Update();
  EXPECT_TRUE(acceptance_.held_back().empty());
  SetSigma(d, 1.2 * limit);
  Update();
  EXPECT_TRUE(acceptance_.held_back().empty());
  SetSigma(d, 2.0 * limit);
  Update();
  EXPECT_EQ(acceptance_.held_back().size(), 1u);
}

TEST_F(HeldBackTest, WhatIsNotANumberIsNotUsed) {
  for (int i = 0; i < 4; ++i) Update();
  ASSERT_TRUE(acceptance_.accepted());
  SetSigma(Index("centre_of_gravity.z"), 0.02);  // something to condition on
  snapshot_.covariance(2, 3) = std::nan("");
  Update();
  EXPECT_FALSE(acceptance_.accepted());
  EXPECT_TRUE(acceptance_.Usable().covariance.allFinite());
}

TEST_F(HeldBackTest, NothingIsAcceptedWithoutThrust) {
  SetSigma(Index("thrust.k_f"), 3e-7);
  for (int i = 0; i < 4; ++i) Update();
  EXPECT_FALSE(acceptance_.accepted());
}

TEST_F(HeldBackTest, NothingIsAcceptedWithTheInertiaOfAnotherVehicle) {
  snapshot_.values[Index("inertia.x")] *= 6.0;
  for (int i = 0; i < 4; ++i) Update();
  EXPECT_FALSE(acceptance_.accepted());
  ASSERT_FALSE(acceptance_.reasons().empty());
  EXPECT_NE(acceptance_.reasons().front().find("inertia.x"), std::string::npos);
}

TEST_F(HeldBackTest, AGoodEstimateHasToLastAndToLastAnewAfterABadOne) {
  const int k_f = Index("thrust.k_f");
  for (int round = 0; round < 2; ++round) {
    SetSigma(k_f, 3e-7);
    Update();
    SetSigma(k_f, 1e-8);
    Update();
    Update();
    EXPECT_FALSE(acceptance_.accepted()) << "good for 0.6 s only";
    Update();
    EXPECT_TRUE(acceptance_.accepted());
  }
}

}  // namespace
}  // namespace odmc
