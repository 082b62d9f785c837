#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "odmc/sensing/plausible.h"
#include "odmc/sensing/rotor_dropout.h"
#include "odmc/sensing/synchroniser.h"

namespace odmc {
namespace test {
namespace {

/// Four rotors about 800 rad/s for 10 s.
FlightLog Turning(double rate_hz) {
  FlightLog log;
  for (int i = 0; i < 10.0 * rate_hz; ++i) {
    const double t = i / rate_hz;
    OdometrySample odometry;
    odometry.stamp = FromSeconds(t);
    odometry.p_WS.x() = t;
    log.odometry.push_back(odometry);
    log.rotors.push_back(
        {odometry.stamp, RotorVector::Constant(4, 800.0 + 200.0 * std::sin(9.0 * t))});
  }
  return log;
}

/// Sets rotors to what `speed` makes of time since `from_s` and their speed.
template <typename Speed>
void Change(double from_s, double to_s, unsigned rotors, const Speed& speed, FlightLog* log) {
  for (RotorSample& sample : log->rotors) {
    const double t = ToSeconds(sample.stamp);
    if (t < from_s || t >= to_s) continue;
    for (Eigen::Index j = 0; j < 4; ++j) {
      if ((rotors >> j & 1U) != 0U) sample.speed[j] = speed(t - from_s, sample.speed[j]);
    }
  }
}

const auto kNone = [](double, double) { return 0.0; };

TEST(RotorDropout, MissingReadingsLeaveTheStream) {
  for (const double rate_hz : {50.0, 100.0, 500.0}) {
    FlightLog log = Turning(rate_hz);
    const size_t all = log.rotors.size();
    Change(4.0, 6.0, 0b1111, kNone, &log);
    Change(8.0, 8.1, 0b0100, kNone, &log);
    MendFlight(&log);
    EXPECT_NEAR(static_cast<double>(all - log.rotors.size()), 2.1 * rate_hz, 2.0) << rate_hz;
    for (const RotorSample& sample : log.rotors) EXPECT_GT(sample.speed.minCoeff(), 500.0);
    ASSERT_EQ(log.warnings.size(), 1u) << rate_hz;
    EXPECT_NE(log.warnings[0].find("rotor1, rotor2, rotor3, rotor4"), std::string::npos);
    EXPECT_NE(log.warnings[0].find("2 times, the first from 4.000 to"), std::string::npos)
        << log.warnings[0];
  }
}

TEST(RotorDropout, ARotorThatStopsSpoolsDownAndStays) {
  for (const double rate_hz : {20.0, 100.0, 500.0}) {
    FlightLog log = Turning(rate_hz);
    // Braked as quickly as any on record, standing for a second, and up again in 60 ms.
    const auto braked = [](double t, double speed) {
      return std::max(0.0, speed * std::exp(-(t + 0.002) / 0.016));
    };
    const auto up = [](double t, double speed) { return speed * t / 0.06; };
    Change(3.0, 4.0, 0b0010, braked, &log);
    Change(4.0, 4.06, 0b0010, up, &log);
    // Cut off at the end, as when a log goes on after landing.
    Change(9.0, 11.0, 0b1111, kNone, &log);
    const size_t all = log.rotors.size();
    MendFlight(&log);
    EXPECT_TRUE(log.warnings.empty()) << rate_hz << ": " << log.warnings[0];
    EXPECT_EQ(log.rotors.size(), all);
  }
}

// A reading that is missing for most of a flight belongs to a dead sensor.
TEST(RotorDropout, ADeadSensorIsLeftToOthers) {
  FlightLog log = Turning(200.0);
  for (int i = 1; i < 10; ++i) Change(i, i + 0.6, 0b0001, kNone, &log);
  const size_t all = log.rotors.size();
  MendFlight(&log);
  EXPECT_EQ(log.rotors.size(), all);
}

TEST(RotorDropout, ARefusedSampleEndsNoDropout) {
  FlightLog log = Turning(200.0);
  Change(4.0, 5.0, 0b1111, kNone, &log);
  Synchroniser synchroniser(50.0, 0.3);
  double least = 1e9;
  for (size_t i = 0; i < log.odometry.size(); ++i) {
    synchroniser.Add(log.odometry[i]);
    EXPECT_TRUE(synchroniser.Add(log.rotors[i]));
    RotorSample wrong = log.rotors[i];
    wrong.speed[1] = std::nan("");
    EXPECT_FALSE(synchroniser.Add(wrong));
    while (const auto keyframe = synchroniser.NextKeyframe()) {
      for (const RotorSample& sample : synchroniser.rotors()) {
        if (sample.stamp <= keyframe->stamp) least = std::min(least, sample.speed.minCoeff());
      }
    }
  }
  EXPECT_GT(least, 500.0);
  EXPECT_EQ(synchroniser.counters().rotor_dropouts, 1);
}

TEST(RotorDropout, TheSynchroniserWaitsForReadings) {
  FlightLog log = Turning(200.0);
  Change(4.0, 5.0, 0b1111, kNone, &log);
  Synchroniser synchroniser(50.0, 0.3);
  double least = 1e9, longest_silence_s = 0.0;
  for (size_t i = 0; i < log.odometry.size(); ++i) {
    synchroniser.Add(log.odometry[i]);
    synchroniser.Add(log.rotors[i]);
    while (const auto keyframe = synchroniser.NextKeyframe()) {
      const RotorSample& newest = synchroniser.rotors().back();
      longest_silence_s = std::max(longest_silence_s, ToSeconds(keyframe->stamp - newest.stamp));
      for (const RotorSample& sample : synchroniser.rotors()) {
        if (sample.stamp <= keyframe->stamp) least = std::min(least, sample.speed.minCoeff());
      }
    }
  }
  EXPECT_GT(least, 500.0);
  EXPECT_GT(longest_silence_s, 0.6);  // keyframes in the gap have no rotor speeds
  EXPECT_EQ(synchroniser.counters().rotor_dropouts, 1);
  EXPECT_EQ(synchroniser.counters().first_dropout.rotors, 0b1111u);
  EXPECT_NEAR(static_cast<double>(synchroniser.counters().first_dropout.readings), 200.0, 1.0);
}

}  // namespace
}  // namespace test
}  // namespace odmc
