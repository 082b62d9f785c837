#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "odmc/math/so3.h"
#include "odmc/sensing/plausible.h"
#include "odmc/sensing/synchroniser.h"

namespace odmc {
namespace test {
namespace {

using Eigen::Vector3d;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kStep_s = 0.005;

/// Every stream of a lively flight, sampled at 200 Hz: rotors at 200 to 1000 rad/s, rates to 12
/// rad/s.
FlightLog Lively() {
  FlightLog log;
  Eigen::Quaterniond q = Eigen::Quaterniond::Identity();
  for (int i = 0; i < 400; ++i) {
    const double t = kStep_s * i;
    const Stamp stamp = FromSeconds(t);
    const Vector3d w(12.0 * std::sin(20.0 * t), 8.0 * std::cos(15.0 * t), 1.0);
    OdometrySample odometry;
    odometry.stamp = stamp;
    odometry.p_WS.x() = t;
    odometry.q_WS = q;
    odometry.w_WS_S = w;
    log.odometry.push_back(odometry);
    const Vector3d force(2.0, 30.0 * std::sin(30.0 * t), 9.8);
    log.imu.push_back({stamp, w, force});
    log.rotors.push_back({stamp, RotorVector::Constant(4, 600.0 + 400.0 * std::sin(25.0 * t))});
    q = q * Exp(kStep_s * w);
  }
  return log;
}

TEST(Plausible, WhatNoSensorReadsIsRefused) {
  FlightLog log = Lively();
  EXPECT_TRUE(IsPlausible(log.odometry[3]));
  EXPECT_TRUE(IsPlausible(log.imu[3]));
  EXPECT_TRUE(IsPlausible(log.rotors[3]));
  for (const double bad : {kNan, 1e200, std::numeric_limits<double>::infinity()}) {
    OdometrySample odometry = log.odometry[3];
    odometry.p_WS.y() = bad;
    EXPECT_FALSE(IsPlausible(odometry)) << bad;
    odometry = log.odometry[3];
    odometry.v_WS = Vector3d(0.0, bad, 0.0);
    EXPECT_FALSE(IsPlausible(odometry)) << bad;
    odometry = log.odometry[3];
    odometry.w_WS_S->z() = bad;
    EXPECT_FALSE(IsPlausible(odometry)) << bad;
    ImuSample imu = log.imu[3];
    imu.gyro_I->x() = bad;
    EXPECT_FALSE(IsPlausible(imu)) << bad;
    imu = log.imu[3];
    imu.specific_force_I->x() = bad;
    EXPECT_FALSE(IsPlausible(imu)) << bad;
    RotorSample rotors = log.rotors[3];
    rotors.speed[2] = bad;
    EXPECT_FALSE(IsPlausible(rotors)) << bad;
  }
  OdometrySample odometry = log.odometry[3];
  odometry.q_WS.coeffs() *= 0.5;
  EXPECT_FALSE(IsPlausible(odometry));
  RotorSample rotors = log.rotors[3];
  rotors.speed[0] = -1.0;
  EXPECT_FALSE(IsPlausible(rotors));
}

TEST(MendFlight, LeavesALivelyFlightAsItIs) {
  FlightLog log = Lively();
  // A rotor sensor's noise around zero, and steps that stay, are no glitches.
  for (int i = 0; i < 30; ++i) log.rotors[i].speed.setConstant(i % 2 == 0 ? 0.0 : 3.0);
  for (size_t i = 300; i < log.rotors.size(); ++i) log.rotors[i].speed[1] = 0.0;
  const FlightLog before = log;
  MendFlight(&log);
  EXPECT_TRUE(log.warnings.empty()) << log.warnings.front();
  ASSERT_EQ(log.odometry.size(), before.odometry.size());
  ASSERT_EQ(log.rotors.size(), before.rotors.size());
  for (size_t i = 0; i < before.rotors.size(); ++i) {
    EXPECT_EQ(log.rotors[i].speed, before.rotors[i].speed);
    EXPECT_EQ(*log.imu[i].gyro_I, *before.imu[i].gyro_I);
  }
}

TEST(MendFlight, MendsSingleReadingsAndNamesTheirTimes) {
  FlightLog log = Lively();
  const FlightLog before = log;
  log.rotors[100].speed[2] = 5000.0;
  log.rotors[200].speed[0] = 0.0;
  log.rotors[250].speed[3] = 65535.0;  // beyond any
  log.imu[120].gyro_I->y() = 35.0;
  log.imu[160].specific_force_I->z() = -160.0;
  log.odometry[300].w_WS_S->x() += 30.0;
  MendFlight(&log);
  EXPECT_EQ(log.rotors.size(), before.rotors.size() - 1);
  EXPECT_EQ(log.odometry.size(), before.odometry.size() - 1);
  EXPECT_EQ(log.dropped, 1);
  EXPECT_NEAR(log.rotors[100].speed[2], before.rotors[100].speed[2], 10.0);
  EXPECT_EQ(log.rotors[100].speed[1], before.rotors[100].speed[1]);
  EXPECT_NEAR(log.rotors[200].speed[0], before.rotors[200].speed[0], 10.0);
  EXPECT_NEAR(log.imu[120].gyro_I->y(), before.imu[120].gyro_I->y(), 0.1);
  EXPECT_EQ(log.imu[120].gyro_I->x(), before.imu[120].gyro_I->x());
  EXPECT_NEAR(log.imu[160].specific_force_I->z(), 9.8, 1e-9);
  ASSERT_EQ(log.warnings.size(), 4u);
  EXPECT_NE(log.warnings[0].find("1 sample of odometry"), std::string::npos) << log.warnings[0];
  EXPECT_NE(log.warnings[0].find("1.500 s"), std::string::npos) << log.warnings[0];
  EXPECT_NE(log.warnings[1].find("2 samples of the IMU"), std::string::npos) << log.warnings[1];
  EXPECT_NE(log.warnings[1].find("the first 0.600 s"), std::string::npos) << log.warnings[1];
  EXPECT_NE(log.warnings[2].find("1.250 s"), std::string::npos) << log.warnings[2];
  EXPECT_NE(log.warnings[3].find("0.500 s"), std::string::npos) << log.warnings[3];
}

TEST(MendFlight, StampsThatJitterMakeNoGlitches) {
  FlightLog log = Lively();
  for (size_t i = 0; i < log.odometry.size(); i += 4) {
    log.odometry[i].stamp += FromSeconds(0.8 * kStep_s);
  }
  const size_t before = log.odometry.size();
  MendFlight(&log);
  EXPECT_EQ(log.odometry.size(), before);
}

TEST(Synchroniser, ANewestReadingThatLeapsWaitsForTheNextOne) {
  const FlightLog log = Lively();
  Synchroniser synchroniser(200.0, 0.3);
  const auto feed = [&](size_t i, double speed) {
    RotorSample rotors = log.rotors[i];
    rotors.speed[1] = speed;
    synchroniser.Add(rotors);
    synchroniser.Add(log.odometry[i]);
  };
  feed(0, 600.0);
  feed(1, 600.0);
  EXPECT_TRUE(synchroniser.NextKeyframe());
  EXPECT_TRUE(synchroniser.NextKeyframe());
  feed(2, 6000.0);
  EXPECT_FALSE(synchroniser.NextKeyframe());
  feed(3, 610.0);
  EXPECT_TRUE(synchroniser.NextKeyframe());
  EXPECT_NEAR(synchroniser.rotors()[2].speed[1], 605.0, 1e-6);
  EXPECT_EQ(synchroniser.counters().glitches, 1);
  EXPECT_EQ(synchroniser.counters().first_glitch, log.rotors[2].stamp);
  EXPECT_TRUE(synchroniser.NextKeyframe());
  // A step that stays is one.
  feed(4, 100.0);
  EXPECT_FALSE(synchroniser.NextKeyframe());
  feed(5, 100.0);
  EXPECT_TRUE(synchroniser.NextKeyframe());
  EXPECT_EQ(synchroniser.rotors().back().speed[1], 100.0);
  EXPECT_EQ(synchroniser.counters().glitches, 1);
}

TEST(Synchroniser, KnowsARepeatedPoseByWhatItIsAfterNormalising) {
  Synchroniser synchroniser(100.0, 0.3);
  OdometrySample sample;
  sample.q_WS.coeffs() << 0.1234567, -0.2345678, 0.3456789, 0.9012345;
  sample.q_WS.coeffs() *= 1.001 / sample.q_WS.norm();
  for (int i = 1; i <= 50; ++i) {
    sample.stamp = FromSeconds(0.01 * i);
    EXPECT_EQ(synchroniser.Add(sample), i == 1);
  }
  EXPECT_EQ(synchroniser.counters().repeated_pose, 49);
}

}  // namespace
}  // namespace test
}  // namespace odmc
