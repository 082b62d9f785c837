// A replay in the background ends when it is told to: a node that stops cannot wait for it.
#include <gtest/gtest.h>

#include "odmc/analysis/calibration.h"
#include "odmc/analysis/replay.h"
#include "odmc/estimator/estimator.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace test {
namespace {

class GivingUp : public ::testing::Test {
 protected:
  GivingUp() : model_(NominalVehicle(), NominalVehicle().effects) {
    SimulationOptions simulation;
    simulation.duration_s = 6.0;
    simulation.log_rate_hz = 200.0;
    log_ = Simulate(model_, DefaultTruth(model_), simulation, SimulationNoise()).log;
    options_.keyframe_rate_hz = 50.0;
  }

  DynamicModel model_;
  FlightLog log_;
  EstimatorOptions options_ = OfflineOptions();
};

TEST_F(GivingUp, AReplayKeepsWhatItHasSeen) {
  Estimator whole(&model_, options_, true);
  const ReplayResult all = Replay(log_, &whole);
  Estimator estimator(&model_, options_, true);
  int asked = 0;
  const ReplayResult part = Replay(log_, &estimator, {}, [&asked] { return ++asked == 10; });
  EXPECT_EQ(10, asked);
  ASSERT_FALSE(part.history.empty());
  // 577 of 1200 poses were fed.
  EXPECT_LT(part.history.size(), all.history.size() / 2);
  EXPECT_GT(part.history.size(), all.history.size() / 3);
  for (size_t i = 0; i < part.history.size(); ++i) {
    ASSERT_EQ(all.history[i].values, part.history[i].values) << "update " << i;
  }
}

TEST_F(GivingUp, NoErrorIsJudgedByAPart) {
  const std::vector<StreamDoubt> doubts = {{"rotor_speeds", 0.002, 1.0, -1},
                                           {"gyro", 0.001, 1.0, -1}};
  const auto changes = [&](int most) {
    int asked = 0;
    return ChangesWithout(doubts, log_, log_.odometry.front().stamp, model_, options_, nullptr,
                          [&asked, most] { return ++asked > most; });
  };
  EXPECT_EQ(2u, changes(1000000).size());
  EXPECT_TRUE(changes(0).empty());
  EXPECT_TRUE(changes(30).empty());  // in the second of three replays
}

}  // namespace
}  // namespace test
}  // namespace odmc
