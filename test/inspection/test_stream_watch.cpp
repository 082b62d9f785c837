#include <gtest/gtest.h>

#include <stdexcept>

#include "odmc/inspection/stream_watch.h"

namespace odmc {
namespace {

OdometrySample Pose(double t_s) {
  OdometrySample sample;
  sample.stamp = FromSeconds(t_s);
  return sample;
}

RotorSample Rotors(double t_s) {
  RotorSample sample;
  sample.stamp = FromSeconds(t_s);
  sample.speed = RotorVector::Constant(4, 500.0);
  return sample;
}

TEST(StreamWatch, KeepsTheNewestSecondsAndIsDueNowAndThen) {
  StreamWatch::Options options;
  options.keep_s = 5.0;
  options.every_s = 2.0;
  StreamWatch watch(Vehicle(), options);
  EXPECT_FALSE(watch.IsDue());
  for (int i = 0; i < 1000; ++i) {
    watch.Add(Pose(0.01 * i));
    watch.Add(Rotors(0.01 * i));
    EXPECT_EQ(watch.IsDue(), i >= 200);
  }
  const FlightLog log = watch.TakeLook();
  EXPECT_FALSE(watch.IsDue());
  EXPECT_EQ(log.odometry.back().stamp, FromSeconds(9.99));
  EXPECT_NEAR(ToSeconds(log.odometry.front().stamp), 4.99, 0.011);
  EXPECT_EQ(log.rotors.size(), log.odometry.size());
}

TEST(StreamWatch, MemoryIsBoundedWhateverTheRate) {
  StreamWatch::Options options;
  options.most_samples = 100;
  StreamWatch watch(Vehicle(), options);
  for (int i = 0; i < 5000; ++i) watch.Add(Rotors(1e-4 * i));
  EXPECT_EQ(watch.TakeLook().rotors.size(), 100u);
}

TEST(StreamWatch, AStreamThatStoppedLongAgoIsNotLookedAt) {
  StreamWatch::Options options;
  options.keep_s = 5.0;
  StreamWatch watch(Vehicle(), options);
  for (int i = 0; i < 300; ++i) watch.Add(Rotors(0.01 * i));
  for (int i = 0; i < 2000; ++i) watch.Add(Pose(0.01 * i));
  EXPECT_TRUE(watch.TakeLook().rotors.empty());
}

TEST(StreamWatch, AClockThatStepsBackStartsAnew) {
  StreamWatch watch{Vehicle()};
  for (int i = 0; i < 100; ++i) watch.Add(Pose(10.0 + 0.01 * i));
  watch.Add(Pose(1.0));
  const FlightLog log = watch.TakeLook();
  EXPECT_EQ(log.odometry.size(), 1u);
}

TEST(StreamWatch, ALateSampleIsLeftOut) {
  StreamWatch::Options options;
  options.every_s = 2.0;
  StreamWatch watch(Vehicle(), options);
  for (int i = 0; i <= 300; ++i) {
    watch.Add(Pose(10.0 + 0.01 * i));
    watch.Add(Rotors(10.0 + 0.01 * i));
    if (i % 50 == 49) watch.Add(Rotors(10.0 + 0.01 * i - 0.001));
  }
  EXPECT_TRUE(watch.IsDue());
  EXPECT_EQ(watch.TakeLook().rotors.size(), 301u);
}

TEST(StreamWatch, RefusesOptionsThatKeepNothing) {
  StreamWatch::Options options;
  options.keep_s = 0.0;
  EXPECT_THROW(StreamWatch(Vehicle(), options), std::invalid_argument);
}

}  // namespace
}  // namespace odmc
