#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <stdexcept>

#include "odmc/control/allocation.h"
#include "odmc/control/control_model.h"
#include "odmc/sim/truth_vehicle.h"
#include "support/test_vehicle.h"

namespace odmc {
namespace {

constexpr double kMin = 1e4, kMax = 4e6;  // (rad/s)²

RotorMap MapOf(const Vehicle& vehicle) {
  const DynamicModel model(vehicle, vehicle.effects);
  const ModelValues truth = DefaultTruth(model);
  return RotorMapAtRest(model, truth, model.Properties(truth));
}

Allocation NominalAllocation() {
  const Vehicle vehicle = test::NominalVehicle();
  return Allocation(MapOf(vehicle), vehicle.ArmLength(), kMin, kMax);
}

Vehicle Hexacopter() {
  Vehicle vehicle = test::NominalVehicle();
  vehicle.rotors.clear();
  for (int j = 0; j < 6; ++j) {
    const double angle = M_PI / 3.0 * j;
    vehicle.rotors.push_back(
        {{0.2 * std::cos(angle), 0.2 * std::sin(angle), 0.0}, j % 2 == 0 ? 1.0 : -1.0, 0.0635});
  }
  return vehicle;
}

TEST(RotorMap, SeesHubsFromTheCentreOfMass) {
  const Vehicle vehicle = test::NominalVehicle();
  const DynamicModel model(vehicle, vehicle.effects);
  const ModelValues truth = DefaultTruth(model);
  const BodyProperties properties = model.Properties(truth);
  ASSERT_GT(properties.p_BBcm.norm(), 0.01);
  const RotorMap map = RotorMapAtRest(model, truth, properties);
  const double k_f = truth[model.IndexOf("thrust.k_f")];
  const double k_m = truth[model.IndexOf("rotor_torque.k_m")];
  for (int j = 0; j < vehicle.num_rotors(); ++j) {
    const Eigen::Vector3d arm = vehicle.rotors[j].p_BP - properties.p_BBcm;
    EXPECT_NEAR(map(0, j), k_f, 1e-12);
    EXPECT_NEAR(map(1, j), k_f * arm.y(), 1e-12);
    EXPECT_NEAR(map(2, j), -k_f * arm.x(), 1e-12);
    EXPECT_NEAR(map(3, j), vehicle.rotors[j].spin * k_m, 1e-12);
  }
}

TEST(Allocation, MakesWhatIsAskedForWithinLimits) {
  for (const Vehicle& vehicle : {test::NominalVehicle(), test::NanoVehicle(), Hexacopter()}) {
    const RotorMap map = MapOf(vehicle);
    const double hover = vehicle.mass_kg * 9.81 / map.row(0).sum();
    const Allocation allocation(map, vehicle.ArmLength(), 0.02 * hover, 3.0 * hover);
    const double weight = vehicle.mass_kg * 9.81;
    const double torque = 0.1 * weight * vehicle.ArmLength();
    const Eigen::Vector4d wrench(1.2 * weight, torque, -0.5 * torque, 0.02 * torque);
    AllocationReport report;
    const RotorVector squared = allocation.SquaredSpeeds(wrench, &report);
    EXPECT_FALSE(report.saturated()) << vehicle.rotors.size();
    EXPECT_LT((allocation.WrenchOf(squared) - wrench).norm(), 1e-9 * wrench.norm());
  }
}

// Whatever is asked: limits hold; roll and pitch come before thrust, thrust before yaw.
TEST(Allocation, GivesUpYawThenThrustThenTilt) {
  const Allocation allocation = NominalAllocation();
  std::mt19937 random(1);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  int tilts = 0, thrusts = 0, yaws = 0;
  for (int i = 0; i < 2000; ++i) {
    const Eigen::Vector4d asked(10.0 + 16.0 * uniform(random), 2.5 * uniform(random),
                                2.5 * uniform(random), 0.3 * uniform(random));
    AllocationReport report;
    const RotorVector squared = allocation.SquaredSpeeds(asked, &report);
    ASSERT_GE(squared.minCoeff(), kMin);
    ASSERT_LE(squared.maxCoeff(), kMax);
    const Eigen::Vector4d given = allocation.WrenchOf(squared);
    // The axis of the torque stays, its size is the reported share of it.
    EXPECT_NEAR(given[1], report.roll_pitch_share * asked[1], 1e-9);
    EXPECT_NEAR(given[2], report.roll_pitch_share * asked[2], 1e-9);
    EXPECT_NEAR(given[3], report.yaw_share * asked[3], 1e-9);
    EXPECT_NEAR(given[0], asked[0] + report.thrust_change_N, 1e-9);
    if (report.roll_pitch_share < 1.0) {
      ++tilts;
      EXPECT_NEAR(squared.maxCoeff() - squared.minCoeff(), kMax - kMin, 1e-3);
    }
    if (report.thrust_change_N != 0.0) ++thrusts;
    if (report.yaw_share < 1.0) {
      ++yaws;
      EXPECT_TRUE(squared.minCoeff() < kMin + 1e-3 || squared.maxCoeff() > kMax - 1e-3);
    }
  }
  EXPECT_GT(tilts, 100);
  EXPECT_GT(thrusts, tilts);
  EXPECT_GT(yaws, tilts);
}

// As little thrust is given up as roll and pitch need.
TEST(Allocation, ChangesThrustByAsLittleAsItTakes) {
  const Allocation allocation = NominalAllocation();
  AllocationReport report;
  const double most = allocation.WrenchOf(RotorVector::Constant(4, kMax))[0];
  const RotorVector squared = allocation.SquaredSpeeds({most, 0.4, 0.0, 0.0}, &report);
  EXPECT_LT(report.thrust_change_N, 0.0);
  EXPECT_DOUBLE_EQ(report.roll_pitch_share, 1.0);
  EXPECT_DOUBLE_EQ(squared.maxCoeff(), kMax);
}

TEST(Allocation, RefusesVehiclesThatCannotBeFlown) {
  const Vehicle vehicle = test::NominalVehicle();
  RotorMap no_yaw = MapOf(vehicle);
  no_yaw.row(3).setZero();
  EXPECT_THROW(Allocation(no_yaw, 0.15, kMin, kMax), std::invalid_argument);
  RotorMap nothing = MapOf(vehicle);
  nothing(0, 0) = std::nan("");
  EXPECT_THROW(Allocation(nothing, 0.15, kMin, kMax), std::invalid_argument);
  RotorMap outside = MapOf(vehicle);
  outside.row(2) += 0.3 * outside.row(0);
  EXPECT_THROW(Allocation(outside, 0.15, kMin, kMax), std::invalid_argument);
}

}  // namespace
}  // namespace odmc
