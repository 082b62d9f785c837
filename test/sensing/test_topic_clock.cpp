#include <gtest/gtest.h>

#include "odmc/sensing/topic_clock.h"

namespace odmc {
namespace test {
namespace {

Stamp At(double t_s) { return FromSeconds(t_s); }

TEST(TopicClock, ALateMessageIsNoStepOfTheClock) {
  TopicClock clock;
  for (double t = 100.0; t < 101.0; t += 0.01) {
    EXPECT_EQ(clock.See(At(t), At(t)), StampVerdict::kForward);
  }
  EXPECT_EQ(clock.See(At(100.7), At(101.0)), StampVerdict::kForward) << "hardly late";
  EXPECT_EQ(clock.See(At(20.0), At(101.01)), StampVerdict::kRefused);
  EXPECT_GT(clock.newest(), At(100.9)) << "a late one moves nothing";
  // Late ones come among good ones for as long as they like.
  for (double t = 101.02; t < 105.0; t += 0.02) {
    EXPECT_EQ(clock.See(At(t), At(t)), StampVerdict::kForward);
    EXPECT_EQ(clock.See(At(t - 1.0), At(t + 0.01)), StampVerdict::kRefused);
  }
}

TEST(TopicClock, OldMessagesAloneAreAStep) {
  TopicClock clock;
  EXPECT_EQ(clock.See(At(100.0), At(100.0)), StampVerdict::kForward);
  int late = 0;
  double t = 0.0;
  for (; t < 1.0; t += 0.01) {
    const StampVerdict verdict = clock.See(At(5.0 + t), At(100.01 + t));
    if (verdict == StampVerdict::kBack) break;
    EXPECT_EQ(verdict, StampVerdict::kRefused);
    ++late;
  }
  EXPECT_NEAR(late, 51, 1) << "for half a second they may be late";
  EXPECT_NEAR(ToSeconds(clock.newest()), 5.0 + t, 1e-9);
  EXPECT_EQ(clock.See(At(5.0 + t + 0.01), At(101.0)), StampVerdict::kForward);
}

}  // namespace
}  // namespace test
}  // namespace odmc
