#include <gtest/gtest.h>

#include <Eigen/Geometry>

#include "odmc/inspection/force_balance.h"
#include "support/rotor_frames.h"

namespace odmc {
namespace test {
namespace {

std::optional<ForceBalance> BalanceOf(const FlightLog& log, double gravity_m_s2 = 9.81) {
  const auto signals = SignalsOf(log);
  if (!signals) return std::nullopt;
  return BalanceForces(*signals, gravity_m_s2, FindFlight(*signals));
}

double TrueShare(const Vehicle& vehicle) {
  return *vehicle.parameters.at("thrust.k_f").value / vehicle.mass_kg;
}

TEST(ForceBalance, FindsThrustOverMass) {
  for (const Vehicle& vehicle : {NominalVehicle(), NanoVehicle()}) {
    for (const char* trajectory : {"hover", "octo", "circle", "vertical", "aggressive"}) {
      const auto balance = BalanceOf(Flown(vehicle, trajectory, 20.0));
      ASSERT_TRUE(balance) << trajectory;
      const double ratio = balance->k_f_over_mass / TrueShare(vehicle);
      EXPECT_NEAR(ratio, 1.0, 0.015) << trajectory;
      EXPECT_LT(std::abs(ratio - 1.0), 5.0 * balance->relative_sigma + 0.005) << trajectory;
      EXPECT_LT(balance->lean_rad, 0.02) << trajectory;
    }
  }
}

TEST(ForceBalance, HoverSpeedCarriesTheWeight) {
  const Vehicle vehicle = NominalVehicle();
  const auto balance = BalanceOf(Flown(vehicle, "hover", 20.0));
  ASSERT_TRUE(balance);
  const double hover = std::sqrt(9.81 / TrueShare(vehicle) / 4.0);
  EXPECT_NEAR(balance->hover_speed_rad_s, hover, 0.01 * hover);
}

// The pose is that of a marker frame that leans by ten degrees about an axis between x and y.
TEST(ForceBalance, FindsTheThrustAxisOfALeaningFrame) {
  const Vehicle vehicle = NominalVehicle();
  FlightLog log = Flown(vehicle, "octo", 20.0);
  const Eigen::Quaterniond q_BS(
      Eigen::AngleAxisd(0.17, Eigen::Vector3d(0.8, -0.6, 0.0).normalized()));
  for (OdometrySample& pose : log.odometry) {
    pose.q_WS = pose.q_WS * q_BS;
    pose.w_WS_S.reset();
  }
  const auto balance = BalanceOf(log);
  ASSERT_TRUE(balance);
  const Eigen::Vector3d axis_S = q_BS.conjugate() * Eigen::Vector3d::UnitZ();
  EXPECT_LT((balance->thrust_axis_S - axis_S).norm(), 0.01);
  EXPECT_NEAR(balance->lean_rad, 0.17, 0.01);
  EXPECT_NEAR(balance->k_f_over_mass / TrueShare(vehicle), 1.0, 0.015);
}

// A vehicle in somebody's hands for a fifth of the time is outvoted.
TEST(ForceBalance, AFewSecondsOfSomethingElseAreOutvoted) {
  const Vehicle vehicle = NominalVehicle();
  FlightLog log = Flown(vehicle, "octo", 30.0);
  for (RotorSample& sample : log.rotors) {
    const double t_s = ToSeconds(sample.stamp);
    if (t_s > 10.0 && t_s < 13.0) sample.speed *= 0.8;
  }
  const auto balance = BalanceOf(log);
  ASSERT_TRUE(balance);
  EXPECT_NEAR(balance->k_f_over_mass / TrueShare(vehicle), 1.0, 0.03);
}

TEST(ForceBalance, SaysNothingWithoutFlight) {
  FlightLog log = Flown(NominalVehicle(), "hover", 20.0);
  FlightLog none = log, brief = log;
  none.rotors.clear();
  brief.odometry.resize(300);
  EXPECT_FALSE(BalanceOf(none));
  EXPECT_FALSE(BalanceOf(brief));
  EXPECT_FALSE(BalanceOf(FlightLog()));
}

}  // namespace
}  // namespace test
}  // namespace odmc
