#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <vector>

#include "odmc/sensing/synchroniser.h"

namespace odmc {
namespace test {
namespace {

OdometrySample Odometry(double time_s) {
  OdometrySample s;
  s.stamp = FromSeconds(time_s);
  s.p_WS.x() = time_s;  // never twice the same
  return s;
}

RotorSample Rotors(double time_s) {
  return {FromSeconds(time_s), RotorVector::Constant(4, 1000.0)};
}

ImuSample Imu(double time_s) {
  ImuSample s;
  s.stamp = FromSeconds(time_s);
  s.gyro_I = Eigen::Vector3d::Zero();
  return s;
}

/// Stamps of all keyframes of a second of odometry at `rate_hz`, keyframes at 100 Hz or fewer.
std::vector<double> KeyframesAt(double rate_hz, double jitter_s = 0.0) {
  Synchroniser synchroniser(100.0, 0.3);
  for (int i = 0; i <= static_cast<int>(rate_hz); ++i) {
    synchroniser.Add(Odometry(1.0 + i / rate_hz + (i % 2 == 0 ? jitter_s : -jitter_s)));
  }
  synchroniser.Add(Rotors(0.9));
  synchroniser.Add(Rotors(3.0));
  std::vector<double> stamps;
  while (const auto keyframe = synchroniser.NextKeyframe())
    stamps.push_back(ToSeconds(keyframe->stamp));
  return stamps;
}

TEST(Synchroniser, WaitsForTheSlowestStreamAndNamesIt) {
  Synchroniser synchroniser(100.0, 0.3);
  synchroniser.Add(Odometry(1.0));
  EXPECT_FALSE(synchroniser.NextKeyframe());
  EXPECT_EQ(synchroniser.waiting_for(), "rotor_speeds");
  synchroniser.Add(Rotors(0.995));
  synchroniser.Add(Imu(0.990));
  EXPECT_FALSE(synchroniser.NextKeyframe());
  EXPECT_EQ(synchroniser.waiting_for(), "rotor_speeds");
  synchroniser.Add(Rotors(1.0));
  EXPECT_FALSE(synchroniser.NextKeyframe());
  EXPECT_EQ(synchroniser.waiting_for(), "imu");
  synchroniser.Add(Imu(1.001));
  const auto keyframe = synchroniser.NextKeyframe();
  ASSERT_TRUE(keyframe);
  EXPECT_EQ(keyframe->stamp, FromSeconds(1.0));
  EXPECT_FALSE(synchroniser.NextKeyframe());
  EXPECT_EQ(synchroniser.waiting_for(), "odometry");
  EXPECT_EQ(synchroniser.counters().uncovered, 0);
}

TEST(Synchroniser, GoesOnWithoutAStreamThatStaysSilentAndCountsIt) {
  Synchroniser synchroniser(100.0, 0.3);
  synchroniser.Add(Rotors(1.0));
  synchroniser.Add(Odometry(1.01));
  EXPECT_FALSE(synchroniser.NextKeyframe());
  for (int i = 1; i < 30; ++i) synchroniser.Add(Odometry(1.01 + 0.01 * i));
  EXPECT_FALSE(synchroniser.NextKeyframe());
  for (int i = 0; i < 3; ++i) synchroniser.Add(Odometry(1.31 + 0.01 * i));
  EXPECT_TRUE(synchroniser.NextKeyframe());
  EXPECT_EQ(synchroniser.counters().uncovered, 1);
}

// A program that stood still for a second reads all of one topic before it reads the next.
TEST(Synchroniser, WaitsForTheBacklogOfTheOtherStream) {
  double now_s = 50.0;
  Synchroniser synchroniser(100.0, 0.3);
  synchroniser.SetArrivalClock([&now_s] { return now_s; });
  synchroniser.Add(Rotors(1.0));
  for (int i = 0; i <= 100; ++i) synchroniser.Add(Odometry(1.01 + 0.01 * i));
  EXPECT_FALSE(synchroniser.NextKeyframe()) << "the rotor speeds are only read later";
  now_s += 0.05;
  for (int i = 0; i <= 50; ++i) synchroniser.Add(Rotors(1.01 + 0.01 * i));
  for (int i = 0; i <= 50; ++i) EXPECT_TRUE(synchroniser.NextKeyframe());
  EXPECT_FALSE(synchroniser.NextKeyframe());
  EXPECT_EQ(synchroniser.counters().uncovered, 0);
  now_s += 0.3;
  EXPECT_TRUE(synchroniser.NextKeyframe()) << "half a second of them never came";
  EXPECT_EQ(synchroniser.counters().uncovered, 1);
}

TEST(Synchroniser, HandsOutWhatIsLeftOnceFinished) {
  Synchroniser synchroniser(100.0, 0.3);
  synchroniser.Add(Odometry(1.0));
  synchroniser.Add(Odometry(1.01));
  EXPECT_FALSE(synchroniser.NextKeyframe());
  synchroniser.Finish();
  EXPECT_TRUE(synchroniser.NextKeyframe());
  EXPECT_TRUE(synchroniser.NextKeyframe());
  EXPECT_FALSE(synchroniser.NextKeyframe());
}

TEST(Synchroniser, CountsWhatComesOutOfOrderAndLeavesItOut) {
  Synchroniser synchroniser(100.0, 0.3);
  synchroniser.Add(Odometry(1.00));
  synchroniser.Add(Odometry(1.02));
  synchroniser.Add(Odometry(1.01));  // steps back
  synchroniser.Add(Rotors(1.00));
  synchroniser.Add(Rotors(1.00));  // repeats
  synchroniser.Add(Rotors(1.05));
  synchroniser.Add(Imu(1.00));
  synchroniser.Add(Imu(0.99));
  synchroniser.Add(Imu(1.06));
  EXPECT_EQ(synchroniser.counters().out_of_order, 3);
  EXPECT_EQ(synchroniser.rotors().size(), 2u);
  EXPECT_EQ(synchroniser.imu().size(), 2u);
  EXPECT_EQ(synchroniser.NextKeyframe()->stamp, FromSeconds(1.00));
  EXPECT_EQ(synchroniser.NextKeyframe()->stamp, FromSeconds(1.02));
}

TEST(Synchroniser, RefusesAndCountsWhatIsNotANumber) {
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  Synchroniser synchroniser(100.0, 0.3);
  OdometrySample odometry = Odometry(1.0);
  odometry.p_WS.y() = kNan;
  synchroniser.Add(odometry);
  odometry = Odometry(1.0);
  odometry.v_WS = Eigen::Vector3d(0.0, kNan, 0.0);
  synchroniser.Add(odometry);
  odometry = Odometry(1.0);
  odometry.w_WS_S = Eigen::Vector3d(0.0, 0.0, std::numeric_limits<double>::infinity());
  synchroniser.Add(odometry);
  odometry = Odometry(1.0);
  odometry.q_WS.coeffs() *= 0.5;  // not unit
  synchroniser.Add(odometry);
  odometry.q_WS.coeffs().setConstant(kNan);
  synchroniser.Add(odometry);
  RotorSample rotors = Rotors(1.0);
  rotors.speed[2] = kNan;
  synchroniser.Add(rotors);
  rotors.speed[2] = -5.0;
  synchroniser.Add(rotors);
  ImuSample imu = Imu(1.0);
  imu.specific_force_I = Eigen::Vector3d(kNan, 0.0, 0.0);
  synchroniser.Add(imu);
  synchroniser.Add(BatterySample{FromSeconds(1.0), 15.0});
  synchroniser.Add(BatterySample{FromSeconds(1.1), kNan});
  EXPECT_EQ(synchroniser.counters().not_finite, 8);
  EXPECT_EQ(synchroniser.battery_voltage_V(), 15.0);
  EXPECT_TRUE(synchroniser.rotors().empty());
  EXPECT_TRUE(synchroniser.imu().empty());
  synchroniser.Finish();
  EXPECT_FALSE(synchroniser.NextKeyframe());
}

TEST(Synchroniser, CountsAPoseThatRepeats) {
  Synchroniser synchroniser(100.0, 0.3);
  OdometrySample sample = Odometry(1.0);
  synchroniser.Add(sample);
  sample.stamp += 10000000;
  synchroniser.Add(sample);
  EXPECT_EQ(synchroniser.counters().repeated_pose, 1);
}

TEST(Synchroniser, PicksEveryFourthOf400Hz) {
  const std::vector<double> stamps = KeyframesAt(400.0);
  ASSERT_EQ(stamps.size(), 101u);
  for (size_t i = 1; i < stamps.size(); ++i) EXPECT_NEAR(stamps[i] - stamps[i - 1], 0.01, 1e-9);
}

TEST(Synchroniser, PicksEveryThirdOf300Hz) {
  const std::vector<double> stamps = KeyframesAt(300.0);
  ASSERT_EQ(stamps.size(), 101u);
  for (size_t i = 1; i < stamps.size(); ++i) EXPECT_NEAR(stamps[i] - stamps[i - 1], 0.01, 1e-8);
}

TEST(Synchroniser, TakesAllOf100HzWhateverTheJitter) {
  EXPECT_EQ(KeyframesAt(100.0).size(), 101u);
  EXPECT_EQ(KeyframesAt(100.0, 0.001).size(), 101u);
}

TEST(Synchroniser, TakesAllOfASlowerSource) { EXPECT_EQ(KeyframesAt(50.0).size(), 51u); }

TEST(Synchroniser, NormalisesQuaternions) {
  Synchroniser synchroniser(100.0, 0.3);
  OdometrySample sample = Odometry(1.0);
  sample.q_WS.coeffs() *= 1.001;
  synchroniser.Add(sample);
  synchroniser.Finish();
  EXPECT_NEAR(synchroniser.NextKeyframe()->q_WS.norm(), 1.0, 1e-15);
}

TEST(Synchroniser, TrimKeepsWhatTheNextIntervalStartsIn) {
  Synchroniser synchroniser(100.0, 0.3);
  for (int i = 0; i < 100; ++i) synchroniser.Add(Rotors(1.0 + 0.0025 * i));
  synchroniser.Trim(FromSeconds(1.101));
  ASSERT_FALSE(synchroniser.rotors().empty());
  EXPECT_LE(synchroniser.rotors().front().stamp, FromSeconds(1.101));
  EXPECT_GT(synchroniser.rotors().front().stamp, FromSeconds(1.09));
}

TEST(Synchroniser, ForgetsWhatNoKeyframeWillAskFor) {
  Synchroniser synchroniser(100.0, 0.3);
  for (int i = 0; i < 100000; ++i) {  // rotors go on, the odometry has died
    synchroniser.Add(Rotors(1.0 + 0.001 * i));
    synchroniser.Add(Imu(1.0 + 0.001 * i));
  }
  EXPECT_LE(synchroniser.rotors().size(), 10002u);
  EXPECT_LE(synchroniser.imu().size(), 10002u);
  EXPECT_EQ(synchroniser.rotors().back().stamp, FromSeconds(1.0 + 0.001 * 99999));
}

TEST(Synchroniser, PicksTheSameWhateverHasComeSince) {
  const auto pick = [](bool wait) {
    Synchroniser synchroniser(50.0, 0.3);
    synchroniser.Add(Rotors(0.9));
    std::vector<Stamp> stamps;
    const auto take = [&] {
      while (const auto keyframe = synchroniser.NextKeyframe()) stamps.push_back(keyframe->stamp);
    };
    // From 200 Hz to 60 Hz: how fine keyframes can be picked changes on the way.
    double time_s = 1.0;
    for (int i = 0; i < 400; ++i, time_s += i < 200 ? 0.005 : 0.0162) {
      synchroniser.Add(Odometry(time_s));
      if (!wait) {
        synchroniser.Add(Rotors(time_s));
        take();
      } else if (i % 10 == 9) {
        synchroniser.Add(Rotors(time_s));
        take();
      }
    }
    return stamps;
  };
  EXPECT_EQ(pick(true), pick(false));
}

TEST(Synchroniser, StartsAnewAfterClear) {
  Synchroniser synchroniser(100.0, 0.3);
  synchroniser.Add(Odometry(100.0));
  synchroniser.Add(Rotors(100.0));
  EXPECT_TRUE(synchroniser.NextKeyframe());
  synchroniser.Clear();
  synchroniser.Add(Odometry(1.0));
  synchroniser.Add(Rotors(1.0));
  EXPECT_TRUE(synchroniser.NextKeyframe());
  EXPECT_EQ(synchroniser.counters().out_of_order, 0);
}

}  // namespace
}  // namespace test
}  // namespace odmc
