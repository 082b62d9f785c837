#include <gtest/gtest.h>

#include <algorithm>

#include "odmc/ros/estimate_session.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace {

constexpr char kEffect[] = "quadratic_drag";

EstimatorNodeSetup MakeSetup() {
  EstimatorNodeSetup setup;
  setup.vehicle = test::NominalVehicle();
  return setup;
}

FlightLog Flight() {
  const DynamicModel flown(test::NominalVehicle(), test::PaperEffects());
  SimulationOptions options;
  options.duration_s = 6.0;
  options.log_rate_hz = 200.0;
  return Simulate(flown, DefaultTruth(flown), options, SimulationNoise()).log;
}

/// A session that is given a flight bit by bit, as the node does.
class EstimateSessionTest : public testing::Test {
 protected:
  EstimateSessionTest() { session_.Start(true); }

  /// The samples that come until `time_s`.
  void FeedUntil(double time_s) {
    const auto feed = [&](const auto& samples, size_t* next) {
      const Stamp end = log_.odometry.front().stamp + FromSeconds(time_s);
      for (; *next < samples.size() && samples[*next].stamp <= end; ++*next) {
        session_.estimator().Add(samples[*next]);
      }
    };
    feed(log_.rotors, &next_rotors_);
    feed(log_.odometry, &next_pose_);
  }

  /// @returns new estimates
  int FlyUntil(double time_s) {
    FeedUntil(time_s);
    int taken = 0;
    while (true) {
      const Snapshot* const snapshot = session_.Step();
      if (!session_.estimator().made_progress()) return taken;
      if (snapshot != nullptr) {
        session_.Take(*snapshot);
        ++taken;
      } else if (session_.last() != nullptr) {
        session_.KeepLast();
      }
    }
  }

  ResidualLook Found() const {
    ResidualLook look;
    look.model = session_.model();
    look.candidate = RankedEffect();
    look.candidate->name = kEffect;
    look.candidate->parameters = {{"quadratic_drag.c_q", "kg/m", 0.03, 0.001, true, true}};
    look.in_a_row = 2;
    return look;
  }

  bool HasEffect() const {
    const std::vector<std::string>& effects = session_.vehicle().effects;
    return std::count(effects.begin(), effects.end(), kEffect) > 0;
  }

  const EstimatorNodeSetup setup_ = MakeSetup();
  const FlightLog log_ = Flight();
  EstimateSession session_{&setup_};
  size_t next_rotors_ = 0, next_pose_ = 0;
};

TEST_F(EstimateSessionTest, LearnsNothingWhileItIsFrozen) {
  ASSERT_GT(FlyUntil(2.0), 0);
  const ModelValues before = session_.last()->values;
  const Stamp stamp = session_.last()->stamp;
  session_.Freeze(true);
  EXPECT_EQ(FlyUntil(3.0), 0);
  EXPECT_EQ(session_.last()->values, before);
  EXPECT_GT(session_.last()->stamp, stamp);  // it still stands
  session_.Freeze(false);
  EXPECT_GT(FlyUntil(4.0), 0);
}

TEST_F(EstimateSessionTest, AddsWhatWasFoundUntilItIsReset) {
  ASSERT_GT(FlyUntil(3.0), 0);
  const ResidualLook found = Found();
  ASSERT_TRUE(session_.Extend(found, true));
  EXPECT_TRUE(HasEffect());
  EXPECT_FALSE(session_.Extend(found, true)) << "was found about the model before";
  ASSERT_GT(FlyUntil(4.0), 0);
  EXPECT_EQ(session_.ToSave().provenance.at("added_in_flight"), kEffect);
  session_.Reset(true);
  EXPECT_FALSE(HasEffect());
  EXPECT_EQ(session_.last(), nullptr);
  EXPECT_EQ(session_.ObjectionToAccepting(), "nothing is estimated yet");
}

TEST_F(EstimateSessionTest, AddsNothingToAnEstimateThatIsForgotten) {
  ASSERT_GT(FlyUntil(2.0), 0);
  session_.estimator().StartAnew();
  FeedUntil(2.1);
  session_.Step();
  EXPECT_EQ(session_.last(), nullptr);
  EXPECT_FALSE(session_.Extend(Found(), true));
  EXPECT_FALSE(HasEffect());
}

}  // namespace
}  // namespace odmc
