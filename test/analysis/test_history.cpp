#include <gtest/gtest.h>

#include <stdexcept>

#include "odmc/analysis/history.h"

namespace odmc {
namespace {

HistoryRow RowOf(int i, int parameters) {
  HistoryRow row;
  row.t_s = 0.01 * i;
  row.values = ModelValues::LinSpaced(parameters, i, i + 1.0 / 3.0);
  row.sigma = Eigen::VectorXd::LinSpaced(parameters, 1.0 / (i + 1), 7.0);
  return row;
}

void ExpectSame(const HistoryRow& a, const HistoryRow& b) {
  EXPECT_EQ(a.t_s, b.t_s);
  EXPECT_EQ(a.values, b.values);
  EXPECT_EQ(a.sigma, b.sigma);
}

// Most of them go through the file.
TEST(EstimateHistory, GivesEveryRowBackBitByBit) {
  constexpr int kRows = 20000, kParameters = 24;  // 8 MB
  EstimateHistory history;
  EXPECT_TRUE(history.empty());
  for (int i = 0; i < kRows; ++i) history.push_back(RowOf(i, kParameters));
  ASSERT_EQ(history.size(), static_cast<size_t>(kRows));
  ExpectSame(history.front(), RowOf(0, kParameters));
  ExpectSame(history.back(), RowOf(kRows - 1, kParameters));
  ExpectSame(history[12345], RowOf(12345, kParameters));
  int next = 0;
  for (const HistoryRow& row : history) ExpectSame(row, RowOf(next++, kParameters));
  EXPECT_EQ(next, kRows);
}

TEST(EstimateHistory, CopiesGrowApart) {
  EstimateHistory one;
  for (int i = 0; i < 9000; ++i) one.push_back(RowOf(i, 24));
  EstimateHistory other = one;
  for (int i = 9000; i < 15000; ++i) one.push_back(RowOf(i, 24));
  for (int i = 9000; i < 15000; ++i) other.push_back(RowOf(-i, 24));
  for (const int i : {0, 8999, 9000, 14999}) {
    ExpectSame(one[static_cast<size_t>(i)], RowOf(i, 24));
    ExpectSame(other[static_cast<size_t>(i)], RowOf(i < 9000 ? i : -i, 24));
  }
}

TEST(EstimateHistory, RowsMustBeOfOneLength) {
  EstimateHistory history;
  history.push_back(RowOf(0, 3));
  EXPECT_THROW(history.push_back(RowOf(1, 4)), std::invalid_argument);
}

}  // namespace
}  // namespace odmc
