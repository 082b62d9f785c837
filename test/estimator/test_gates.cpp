#include <gtest/gtest.h>

#include <cmath>

#include "odmc/estimator/gates.h"
#include "odmc/sim/simulator.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/jacobian_check.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace test {
namespace {

using Eigen::Vector3d;

// ---- InertiaGate -------------------------------------------------------------------------------

void FeedFlight(const SimulatedFlight& flight, const Vehicle& vehicle, InertiaGate* gate) {
  constexpr size_t kStride = 4;
  for (size_t k = 0; k + kStride < flight.truth.size(); k += kStride) {
    const auto& a = flight.truth[k];
    const auto& b = flight.truth[k + kStride];
    RotorVector squared = 0.5 * (a.rotor_speed.cwiseAbs2() + b.rotor_speed.cwiseAbs2());
    for (size_t i = 1; i < kStride; ++i) squared += flight.truth[k + i].rotor_speed.cwiseAbs2();
    squared /= static_cast<double>(kStride);
    gate->Add(ToSeconds(b.stamp - a.stamp), a.w_WB_B, b.w_WB_B,
              RotorTorqueDirection(vehicle, squared), squared.sum());
  }
}

TEST(InertiaGate, OpensOnCleanFlight) {
  const Vehicle vehicle = NominalVehicle();
  const DynamicModel model(vehicle, vehicle.effects);
  SimulationOptions options;
  options.trajectory = "aggressive";
  options.duration_s = 10.0;
  SimulationNoise noise = SimulationNoise::None();
  noise.feedback_rate_rad_s = 0.01;
  InertiaGate gate;
  FeedFlight(Simulate(model, DefaultTruth(model), options, noise), vehicle, &gate);
  for (int axis = 0; axis < 3; ++axis) {
    EXPECT_TRUE(gate.IsOpen(axis)) << axis << ", r^2 " << gate.RSquared(axis);
    EXPECT_GT(gate.RSquared(axis), 0.9) << axis;
  }
}

/// Feeds `seconds` of rates driven by the rotors' roll torque `rotor` and a disturbance `air`,
/// for inertia 0.0025 kg m², with rates read to `noise`.
void FeedRoll(double seconds, double rotor, double air, bool fights, InertiaGate* gate,
              double side = 1.0) {
  constexpr double kDt = 0.01, kInertia = 2.5e-3, kThrust = 1.5e-6, kArm = 0.11;
  Random random(61);
  double disturbance = 0.0, free = 0.0, w = 0.0;
  for (int i = 0; i < static_cast<int>(seconds / kDt); ++i) {
    disturbance = 0.9 * disturbance + air * random.Normal();
    free = 0.9 * free + rotor * random.Normal();
    const double torque = free - (fights ? disturbance : 0.0);
    const double next = 0.98 * w + kDt * (torque + disturbance) / kInertia;
    const double half = 0.25 * torque / (kThrust * kArm);  // left up, right down
    RotorVector squared(4);
    squared << 1.2e6 - half, 1.2e6 + half, 1.2e6 + half, 1.2e6 - half;
    gate->Add(kDt, {w + 0.002 * random.Normal(), 0.0, 0.0},
              {next + 0.002 * random.Normal(), 0.0, 0.0},
              side * RotorTorqueDirection(NominalVehicle(), squared), squared.sum());
    w = next;
  }
}

TEST(InertiaGate, OpensWhereRotorsDriveTheRates) {
  InertiaGate gate;
  FeedRoll(10.0, 0.003, 0.0, false, &gate);
  EXPECT_TRUE(gate.IsOpen(0)) << gate.RSquared(0);
}

TEST(InertiaGate, StaysShutWhereRotorsFightADisturbance) {
  InertiaGate gate;
  FeedRoll(20.0, 0.0003, 0.003, true, &gate);
  EXPECT_FALSE(gate.IsOpen(0)) << gate.RSquared(0);
  EXPECT_LT(gate.RSquared(0), 0.3);
}

TEST(InertiaGate, StaysShutWhereTheDisturbanceDrivesTheRates) {
  InertiaGate gate;
  FeedRoll(20.0, 0.0005, 0.003, false, &gate);
  EXPECT_FALSE(gate.IsOpen(0)) << gate.RSquared(0);
}

TEST(InertiaGate, ShutsAgainWhenADisturbanceTakesOver) {
  InertiaGate gate;
  FeedRoll(5.0, 0.002, 0.0, false, &gate);
  ASSERT_TRUE(gate.IsOpen(0));
  FeedRoll(60.0, 0.0002, 0.006, true, &gate);
  EXPECT_FALSE(gate.IsOpen(0)) << gate.RSquared(0);
}

TEST(InertiaGate, SaysNothingInTheFirstSecondOrWithoutMotion) {
  InertiaGate gate;
  FeedRoll(0.9, 0.003, 0.0, false, &gate);
  EXPECT_FALSE(gate.IsOpen(0));
  InertiaGate still;
  for (int i = 0; i < 500; ++i) {
    still.Add(0.01, Vector3d::Zero(), Vector3d::Zero(), Vector3d::Zero(), 4.8e6);
  }
  for (int axis = 0; axis < 3; ++axis) EXPECT_FALSE(still.IsOpen(axis));
}

TEST(InertiaGate, StaysShutWhereAccelerationOpposesTheTorque) {
  InertiaGate wrong;
  FeedRoll(10.0, 0.003, 0.0, false, &wrong, -1.0);
  EXPECT_FALSE(wrong.IsOpen(0));
  EXPECT_EQ(wrong.RSquared(0), 0.0);
}

}  // namespace
}  // namespace test
}  // namespace odmc
