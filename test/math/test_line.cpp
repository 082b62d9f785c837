#include <gtest/gtest.h>

#include <vector>

#include "odmc/math/line.h"

namespace odmc {
namespace {

TEST(LineThrough, FollowsALine) {
  const std::vector<double> values = {1.0, 3.0, 5.0, 7.0};
  const StraightLine line = LineThrough(values.data(), values.size());
  EXPECT_DOUBLE_EQ(line.slope, 2.0);
  EXPECT_DOUBLE_EQ(line.mean, 4.0);
  EXPECT_DOUBLE_EQ(line.At(0.0), 1.0);
  EXPECT_DOUBLE_EQ(line.At(5.0), 11.0);
}

TEST(LineThrough, HasTheLeastSquares) {
  const std::vector<double> values = {0.0, 0.0, 3.0};
  const StraightLine line = LineThrough(values.data(), values.size());
  EXPECT_DOUBLE_EQ(line.slope, 1.5);
  EXPECT_DOUBLE_EQ(line.At(1.0), 1.0);
}

TEST(LineThrough, IsLevelForOneValue) {
  const double value = 4.0;
  const StraightLine line = LineThrough(&value, 1);
  EXPECT_EQ(line.slope, 0.0);
  EXPECT_EQ(line.At(0.0), 4.0);
}

}  // namespace
}  // namespace odmc
