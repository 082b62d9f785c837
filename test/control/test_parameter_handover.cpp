#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "odmc/control/parameter_handover.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace {

constexpr double kStep_s = 0.01;

// A controller's hand-over, flown with tracking errors that the test chooses.
class HandoverTest : public ::testing::Test {
 protected:
  // An accepted estimate: k_f at `thrust` times nominal, drag d_x.
  ParameterSet Estimate(double thrust, double d_x = -0.3) const {
    ParameterSet set;
    const DynamicModel model(vehicle_, vehicle_.effects);
    set.effects = vehicle_.effects;
    for (const ModelParameter& p : model.parameters()) {
      ParameterEstimate estimate = {p.full_name, p.spec.unit, p.spec.prior_value, 0.0, true, true};
      estimate.sigma = 0.01 * std::abs(p.spec.prior_value);
      if (p.full_name == "thrust.k_f") estimate.value *= thrust;
      if (p.full_name == "drag.d_x") estimate.value = d_x;
      set.parameters.push_back(estimate);
    }
    return set;
  }

  std::string Consider(const ParameterSet& set) { return handover_.Consider(set, now_, now_); }

  // Flies on; with `set`, an estimate comes in five times a second.
  void Fly(double seconds, double error_m, const ParameterSet* set = nullptr) {
    for (int k = 0; k < std::lround(seconds / kStep_s); ++k) {
      now_ += FromSeconds(kStep_s);
      if (set != nullptr && k % 20 == 0) Consider(*set);
      const ModelValues before = handover_.values();
      handover_.Update(now_, error_m);
      if (before.size() == handover_.values().size())
        largest_step_ = std::max(largest_step_, std::abs(Thrust() / before[k_f()] - 1.0));
    }
  }

  int k_f() const { return handover_.model()->IndexOf("thrust.k_f"); }
  double Thrust() const { return handover_.values()[k_f()]; }
  double ThrustOverNominal() const { return Thrust() / 1.5e-6; }

  Vehicle vehicle_ = test::NominalVehicle();
  HandoverOptions options_;
  ParameterHandover handover_{options_, vehicle_};
  Stamp now_ = FromSeconds(100.0);
  double largest_step_ = 0.0;
};

TEST_F(HandoverTest, StartsNominalAndStaysSoWithoutOffers) {
  Fly(10.0, 0.05);
  EXPECT_EQ(handover_.state(), HandoverState::kNominal);
  EXPECT_DOUBLE_EQ(ThrustOverNominal(), 1.0);
  EXPECT_TRUE(handover_.TakeEvents().empty());
}

TEST_F(HandoverTest, FollowsAnEstimateAtALimitedRate) {
  const ParameterSet set = Estimate(1.2);
  Fly(3.0, 0.05);
  Fly(0.2, 0.05, &set);
  EXPECT_EQ(handover_.state(), HandoverState::kFollowing);
  EXPECT_NEAR(ThrustOverNominal(), 1.0 + 0.2 * 0.5 * 1.2, 0.01);  // 50 %/s of the larger value
  Fly(5.0, 0.04, &set);
  EXPECT_NEAR(ThrustOverNominal(), 1.2, 1e-9);
  EXPECT_LE(largest_step_, 1.21 * options_.handover_change_1_s * kStep_s);
}

// Thrust has 0.2 of 1.2 to go, drag all of its value: 0.33 s and 2 s at 50 %/s.
TEST_F(HandoverTest, ThrustDoesNotWaitForWhatHasFartherToGo) {
  const ParameterSet set = Estimate(1.2, -3.0);
  Fly(3.0, 0.05);
  Fly(0.6, 0.05, &set);
  EXPECT_NEAR(ThrustOverNominal(), 1.2, 1e-9);
  EXPECT_LT(handover_.progress(), 0.9);
  Fly(3.0, 0.05, &set);
  EXPECT_EQ(handover_.progress(), 1.0);
}

TEST_F(HandoverTest, RefusesWhatIsNotANumber) {
  for (const double wrong : {std::nan(""), std::numeric_limits<double>::infinity()}) {
    EXPECT_NE(Consider(Estimate(wrong)), "");
    ParameterSet set = Estimate(1.0);
    set.parameters.back().sigma = wrong;
    EXPECT_NE(Consider(set), "");
  }
  Fly(1.0, 0.05);
  EXPECT_EQ(handover_.state(), HandoverState::kNominal);
  EXPECT_TRUE(handover_.values().allFinite());
  EXPECT_EQ(handover_.refused(), 4);
}

TEST_F(HandoverTest, RefusesWhatIsOutOfBoundsAndKeepsWhatItHas) {
  const ParameterSet good = Estimate(1.1);
  Fly(5.0, 0.05, &good);
  for (const ParameterSet& bad : {Estimate(3.5), Estimate(0.2), Estimate(1.1, +0.5)}) {
    now_ += FromSeconds(0.1);
    EXPECT_NE(Consider(bad), "");
  }
  ParameterSet uncertain = Estimate(1.1);
  for (ParameterEstimate& p : uncertain.parameters) {
    if (p.full_name == "thrust.k_f") p.sigma = 0.3 * p.value;
  }
  EXPECT_NE(Consider(uncertain).find("k_f"), std::string::npos);
  Fly(1.0, 0.05);
  EXPECT_NEAR(ThrustOverNominal(), 1.1, 1e-9);
}

TEST_F(HandoverTest, RefusesOldOnesAndRepetitions) {
  Fly(3.0, 0.05);
  EXPECT_NE(handover_.Consider(Estimate(1.1), now_ - FromSeconds(1.5), now_), "");
  EXPECT_EQ(Consider(Estimate(1.1)), "");
  EXPECT_NE(Consider(Estimate(1.1)), "");
}

TEST_F(HandoverTest, RefusesUnknownEffects) {
  ParameterSet set = Estimate(1.0);
  set.effects.push_back("magic");
  EXPECT_NE(Consider(set).find("magic"), std::string::npos);
}

TEST_F(HandoverTest, TakesAModelWithOneMoreEffect) {
  const ParameterSet plain = Estimate(1.1);
  Fly(5.0, 0.05, &plain);
  ParameterSet more = Estimate(1.1);
  more.effects.push_back("wind");
  more.parameters.push_back({"wind.w_x", "m/s", 2.0, 0.1, true, true});
  now_ += FromSeconds(0.1);
  EXPECT_EQ(Consider(more), "");
  EXPECT_NEAR(ThrustOverNominal(), 1.1, 1e-9);  // no step
  Fly(5.0, 0.05, &more);
  EXPECT_NEAR(handover_.values()[handover_.model()->IndexOf("wind.w_x")], 2.0, 1e-9);
}

TEST_F(HandoverTest, HoldsTheLastEstimateWhenTheEstimatorFallsSilentAndFollowsItAgain) {
  const ParameterSet set = Estimate(1.15);
  Fly(6.0, 0.05, &set);
  Fly(1.5, 0.05);
  EXPECT_EQ(handover_.state(), HandoverState::kFollowing);
  Fly(1.0, 0.05);
  EXPECT_EQ(handover_.state(), HandoverState::kHolding);
  EXPECT_NEAR(ThrustOverNominal(), 1.15, 1e-9);
  Fly(options_.handover_hold_s, 0.05);
  Fly(3.0, 0.05);
  EXPECT_EQ(handover_.state(), HandoverState::kNominal);
  EXPECT_NEAR(ThrustOverNominal(), 1.0, 1e-9);
  Fly(1.0, 0.05, &set);
  EXPECT_EQ(handover_.state(), HandoverState::kFollowing);
}

TEST_F(HandoverTest, GoesBackWhenTrackingGetsWorseAfterAChange) {
  const ParameterSet good = Estimate(1.1), bad = Estimate(1.6);
  Fly(8.0, 0.05, &good);
  Fly(0.5, 0.05, &bad);
  Fly(3.0, 0.40, &bad);
  EXPECT_EQ(handover_.state(), HandoverState::kRolledBack);
  Fly(1.0, 0.10, &bad);  // refused for a while
  EXPECT_NEAR(ThrustOverNominal(), 1.1, 1e-6);
  Fly(3.0, 0.05, &bad);
  EXPECT_EQ(handover_.state(), HandoverState::kRolledBack);
  Fly(options_.handover_refuse_s, 0.05, &good);
  EXPECT_EQ(handover_.state(), HandoverState::kFollowing);
}

TEST_F(HandoverTest, GoesBackToNominalWhenTheLastEstimateIsNoBetter) {
  const ParameterSet good = Estimate(1.1), bad = Estimate(1.6);
  Fly(8.0, 0.05, &good);
  Fly(0.5, 0.05, &bad);
  Fly(8.0, 0.40, &bad);
  EXPECT_EQ(handover_.state(), HandoverState::kNominal);
  EXPECT_NEAR(ThrustOverNominal(), 1.0, 1e-9);
}

// A vehicle that was let down by its first estimate has nothing but the file.
TEST_F(HandoverTest, GoesBackToNominalFromTheFirstEstimate) {
  const ParameterSet bad = Estimate(1.6);
  Fly(3.0, 0.05);
  Fly(4.0, 0.40, &bad);
  EXPECT_EQ(handover_.state(), HandoverState::kNominal);
}

TEST_F(HandoverTest, DoesNotBlameTheEstimateForAHarderManoeuvre) {
  const ParameterSet set = Estimate(1.1);
  Fly(8.0, 0.02, &set);
  Fly(5.0, 0.30, &set);  // no change of parameters: no trial
  EXPECT_EQ(handover_.state(), HandoverState::kFollowing);
}

TEST_F(HandoverTest, DoesNotJudgeByATrackingErrorThatIsNotANumber) {
  const ParameterSet good = Estimate(1.1), better = Estimate(1.2);
  Fly(8.0, 0.05, &good);
  Fly(1.0, 0.05, &better);
  Fly(0.1, std::nan(""), &better);
  Fly(3.0, 0.05, &better);
  EXPECT_EQ(handover_.state(), HandoverState::kFollowing);
  EXPECT_NEAR(ThrustOverNominal(), 1.2, 1e-9);
}

TEST_F(HandoverTest, ReportsEveryTransition) {
  const ParameterSet good = Estimate(1.1), bad = Estimate(1.6);
  Fly(8.0, 0.05, &good);
  Fly(0.5, 0.05, &bad);
  Fly(8.0, 0.40, &bad);
  HandoverState state = HandoverState::kNominal;
  int transitions = 0;
  for (const HandoverEvent& event : handover_.TakeEvents()) {
    EXPECT_EQ(event.from, state);
    EXPECT_FALSE(event.reason.empty());
    if (event.from != event.to) ++transitions;
    state = event.to;
  }
  EXPECT_EQ(state, handover_.state());
  EXPECT_EQ(transitions, 3);
  EXPECT_TRUE(handover_.TakeEvents().empty());
}

TEST_F(HandoverTest, StartsAnewAfterReset) {
  const ParameterSet set = Estimate(1.1);
  Fly(8.0, 0.05, &set);
  handover_.Reset(now_);
  EXPECT_EQ(handover_.state(), HandoverState::kNominal);
  EXPECT_DOUBLE_EQ(ThrustOverNominal(), 1.0);
}

}  // namespace
}  // namespace odmc
