#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "odmc/io/entry_stamps.h"

namespace odmc {
namespace {

constexpr Stamp kMs = 1000000;

/// A speed that grows linearly, another way for every rotor.
double SpeedAt(int rotor, Stamp stamp) {
  return 500.0 + 10.0 * rotor + (rotor + 1) * 20.0 * ToSeconds(stamp);
}

// ESCs that answer one after the other: each message has one new reading and three old ones.
TEST(EntryAligner, BringsReadingsInTurnToOneTime) {
  EntryAligner aligner;
  std::vector<double> values(4, 0.0);
  std::vector<Stamp> stamps(4, 0);
  int readings = 0;
  Stamp last = 0;
  for (int i = 0; i < 200; ++i) {
    const auto rotor = static_cast<size_t>(i % 4);
    stamps[rotor] = (100 + 3 * i) * kMs;
    values[rotor] = SpeedAt(i % 4, stamps[rotor]);
    const auto reading = aligner.Add(values, stamps);
    if (!reading) continue;
    ++readings;
    EXPECT_EQ(reading->stamp, stamps[(rotor + 1) % 4]) << "the one that waits longest";
    EXPECT_GT(reading->stamp, last);
    last = reading->stamp;
    for (int j = 0; j < 4; ++j) EXPECT_NEAR(reading->values[j], SpeedAt(j, last), 1e-9);
  }
  // Rotors 2 to 4 have no reading before the first time that all have reached.
  EXPECT_EQ(readings, 200 - 6);
}

TEST(EntryAligner, SaysNothingOverASilence) {
  EntryAligner aligner;
  const auto add = [&](Stamp a, Stamp b) {
    return aligner.Add({SpeedAt(0, a), SpeedAt(1, b)}, {a, b});
  };
  for (Stamp t = 10 * kMs; t < 100 * kMs; t += 10 * kMs) add(t, t + kMs);
  EXPECT_TRUE(add(100 * kMs, 101 * kMs));
  EXPECT_TRUE(add(110 * kMs, 101 * kMs)) << "up to what the second says";
  EXPECT_FALSE(add(120 * kMs, 101 * kMs)) << "nothing new of the second";
  const auto reading = add(130 * kMs, 140 * kMs);
  ASSERT_TRUE(reading) << "39 ms of silence are bridged";
  EXPECT_EQ(reading->stamp, 130 * kMs);
  EXPECT_NEAR(reading->values[1], SpeedAt(1, 130 * kMs), 1e-9);
  EXPECT_FALSE(add(170 * kMs, 190 * kMs)) << "50 ms of silence are not";
  EXPECT_TRUE(add(195 * kMs, 200 * kMs)) << "afterwards it goes on";
}

TEST(EntryAligner, BeginsAnewWithTheClock) {
  EntryAligner aligner;
  for (Stamp t = 5000 * kMs; t < 5100 * kMs; t += 10 * kMs) aligner.Add({1.0, 1.0}, {t, t});
  const auto reading = aligner.Add({7.0, 8.0}, {10 * kMs, 10 * kMs});
  ASSERT_TRUE(reading);
  EXPECT_EQ(reading->stamp, 10 * kMs);
  EXPECT_EQ(reading->values, (std::vector<double>{7.0, 8.0}));
}

TEST(EntryAligner, WaitsForAllToHaveAnswered) {
  EntryAligner aligner;
  for (Stamp t = kMs; t < 50 * kMs; t += kMs) EXPECT_FALSE(aligner.Add({1.0, 2.0}, {t, 0}));
}

// Messages come 2 ms late at least, mostly more; the clock is 30 ppm fast.
TEST(OwnClock, FollowsTheQuickestMessages) {
  constexpr double kFast = 3e-5, kStart_s = 1000.0, kLeast_s = 0.002;
  OwnClock offset;
  double worst_s = 0.0;
  for (int i = 0; i < 60000; ++i) {
    const double time_s = 0.01 * i;  // of reading
    const double late_s = kLeast_s + 0.02 * std::fmod(0.6180339887 * i, 1.0);
    const Stamp own = FromSeconds(time_s * (1.0 + kFast) + 7.0);
    const Stamp stamp = own + offset.Follow(own, FromSeconds(kStart_s + time_s + late_s));
    const double error_s = ToSeconds(stamp) - (kStart_s + time_s + kLeast_s);
    if (i > 1000) worst_s = std::max(worst_s, std::abs(error_s));
  }
  EXPECT_LT(worst_s, 0.0005);
}

TEST(OwnClock, StartsAnewWithEitherClock) {
  OwnClock offset;
  const auto at = [&](double own_s, double message_s) {
    return own_s + ToSeconds(offset.Follow(FromSeconds(own_s), FromSeconds(message_s)));
  };
  at(100.0, 5000.0);
  EXPECT_NEAR(at(101.0, 5001.5), 5001.0, 2e-4) << "a late message";
  EXPECT_NEAR(at(102.0, 5009.0), 5002.0, 3e-4) << "a very late one";
  EXPECT_NEAR(at(0.5, 5010.0), 5010.0, 1e-9) << "a flight controller that restarted";
  double stamp_s = 0.0;
  for (int i = 0; i < 150; ++i) stamp_s = at(1.0 + 0.01 * i, 9000.0 + 0.01 * i);
  EXPECT_NEAR(stamp_s, 9001.49, 1e-6) << "a computer whose time was set";
  EXPECT_NEAR(at(3.0, 4000.0), 4000.0, 1e-9) << "or set back";
}

}  // namespace
}  // namespace odmc
