#include <gtest/gtest.h>

#include "odmc/sensing/stream_pace.h"

namespace odmc {
namespace {

StreamPace Of(double step_s, int count) {
  StreamPace pace;
  for (int i = 0; i < count; ++i) pace.Add(FromSeconds(1.0 + i * step_s));
  return pace;
}

TEST(StreamPace, AFastStreamHasTheHolesThatAllHave) {
  EXPECT_EQ(StreamPace().Hole_s(0.06), 0.06);
  EXPECT_EQ(Of(0.01, 50).Hole_s(0.06), 0.06);
}

TEST(StreamPace, OfASlowStreamOneSampleMayBeMissing) {
  const double hole_s = Of(0.1, 50).Hole_s(0.06);
  EXPECT_GT(hole_s, 0.2);
  EXPECT_LT(hole_s, 0.3);
}

TEST(StreamPace, CountsFromAnyStampOn) {
  for (const double first_s : {-0.1, 0.0, 1.0}) {
    StreamPace pace;
    pace.Add(FromSeconds(first_s));
    pace.Add(FromSeconds(first_s + 0.1));
    EXPECT_NEAR(pace.step_s(), 0.1, 1e-9) << first_s;
  }
}

TEST(StreamPace, HolesAndStampsThatStepBackHardlyCount) {
  StreamPace pace = Of(0.01, 200);
  pace.Add(FromSeconds(60.0));
  pace.Add(FromSeconds(5.0));
  pace.Add(FromSeconds(60.01));
  EXPECT_NEAR(pace.step_s(), 0.01, 0.0006);
}

TEST(StreamPace, OneSampleInFiveSecondsSaysNothingOfWhatLiesBetween) {
  EXPECT_LT(Of(5.0, 100).Hole_s(0.06), 5.0);
}

}  // namespace
}  // namespace odmc
