#include <gtest/gtest.h>

#include <cmath>

#include "odmc/model/pendulum.h"

namespace odmc {
namespace test {
namespace {

using Eigen::Vector3d;

constexpr double kGravity = 9.81;

TEST(Pendulum, HangsStillWithItsWeight) {
  Pendulum pendulum(0.5, 0.0, kGravity);
  for (int i = 0; i < 100; ++i) pendulum.Advance(Vector3d::Zero(), 0.01);
  EXPECT_LT((pendulum.Pull(Vector3d::Zero()) - Vector3d(0.0, 0.0, -kGravity)).norm(), 1e-9);
  // Lifted at 2 m/s² it weighs more; in free fall the cable is slack.
  EXPECT_NEAR(pendulum.Pull({0.0, 0.0, 2.0}).z(), -kGravity - 2.0, 1e-9);
  EXPECT_EQ(pendulum.Pull({0.0, 0.0, -12.0}).norm(), 0.0);
}

TEST(Pendulum, SwingsWithThePeriodOfItsLength) {
  Pendulum pendulum(0.6, 0.0, kGravity);
  for (int i = 0; i < 10; ++i) pendulum.Advance({1.0, 0.0, 0.0}, 0.002);  // a knock
  double t = 0.0, last = pendulum.direction_W().x();
  std::vector<double> crossings;
  while (crossings.size() < 5) {
    pendulum.Advance(Vector3d::Zero(), 0.002);
    t += 0.002;
    const double now = pendulum.direction_W().x();
    if (last < 0.0 && now >= 0.0) crossings.push_back(t);
    last = now;
  }
  const double period = (crossings.back() - crossings.front()) / 4.0;
  EXPECT_NEAR(period, 2.0 * 3.14159265 * std::sqrt(0.6 / kGravity), 0.01);
}

// Small swings: zeta_xy = e^(-d w t) (s cos wt + (r + d s) sin wt) for light damping d.
TEST(Pendulum, StartsWithTheSwingItIsGiven) {
  constexpr double kLength = 0.5, kDamping = 0.03, kStep_s = 0.0005;
  const double omega = std::sqrt(kGravity / kLength);
  const Swing start(0.02, -0.01, 0.005, 0.015);
  Pendulum pendulum(kLength, kDamping, kGravity, start);
  EXPECT_NEAR(pendulum.direction_W().norm(), 1.0, 1e-12);
  double t = 0.0;
  for (int i = 0; i < 6000; ++i) {
    pendulum.Advance(Vector3d::Zero(), kStep_s);
    t += kStep_s;
    const double decay = std::exp(-kDamping * omega * t);
    for (int axis = 0; axis < 2; ++axis) {
      const double expected =
          decay * (start[axis] * std::cos(omega * t) +
                   (start[axis + 2] + kDamping * start[axis]) * std::sin(omega * t));
      ASSERT_NEAR(pendulum.direction_W()[axis], expected, 3e-4) << t;
    }
  }
}

TEST(Pendulum, SwingsNoWiderThanBelowTheVehicle) {
  const Pendulum pendulum(0.5, 0.0, kGravity, Swing(3.0, -4.0, 1.0, 0.0));
  EXPECT_LT(pendulum.direction_W().z(), -0.4);
  EXPECT_TRUE(pendulum.Pull(Vector3d::Zero()).allFinite());
}

TEST(Pendulum, TrailsASteadyAcceleration) {
  Pendulum pendulum(0.4, 0.3, kGravity);
  const Vector3d a(3.0, -1.0, 0.0);
  for (int i = 0; i < 4000; ++i) pendulum.Advance(a, 0.005);
  const Vector3d expected = -(a + kGravity * Vector3d::UnitZ()).normalized();
  EXPECT_LT((pendulum.direction_W() - expected).norm(), 1e-3);
  EXPECT_NEAR(pendulum.Pull(a).norm(), (a + kGravity * Vector3d::UnitZ()).norm(), 1e-2);
}

}  // namespace
}  // namespace test
}  // namespace odmc
