#include <gtest/gtest.h>

#include <algorithm>
#include <deque>
#include <numeric>
#include <vector>

#include "odmc/math/ring.h"

namespace odmc {
namespace test {
namespace {

Ring<int> Counting(int from, int to) {
  Ring<int> ring;
  for (int i = from; i < to; ++i) ring.push_back(i);
  return ring;
}

/// A ring of from..to-1 whose elements lie across the end of the buffer.
Ring<int> Wrapped(int from, int to) {
  Ring<int> ring = Counting(0, 4);  // of 8 that fit before it grows
  while (!ring.empty()) ring.pop_front();
  for (int i = from; i < to; ++i) ring.push_back(i);
  return ring;
}

std::vector<int> Contents(const Ring<int>& ring) { return {ring.begin(), ring.end()}; }

std::vector<int> Range(int from, int to) {
  std::vector<int> range(static_cast<std::size_t>(to - from));
  std::iota(range.begin(), range.end(), from);
  return range;
}

TEST(Ring, StartsEmpty) {
  const Ring<int> ring;
  EXPECT_TRUE(ring.empty());
  EXPECT_EQ(ring.size(), 0u);
  EXPECT_TRUE(ring.begin() == ring.end());
}

TEST(Ring, KeepsItsOrderWhenItGrows) {
  EXPECT_EQ(Contents(Counting(0, 1000)), Range(0, 1000));
  Ring<int> ring = Wrapped(100, 106);
  for (int i = 106; i < 140; ++i) ring.push_back(i);
  EXPECT_EQ(Contents(ring), Range(100, 140));
}

TEST(Ring, GoesRoundItsBuffer) {
  const Ring<int> ring = Wrapped(100, 106);
  EXPECT_EQ(ring.size(), 6u);
  EXPECT_EQ(ring.front(), 100);
  EXPECT_EQ(ring[3], 103);
  EXPECT_EQ(ring.back(), 105);
  EXPECT_LT(&ring.back(), &ring.front()) << "the test means to wrap";
}

TEST(Ring, DoesWhatADequeDoes) {
  Ring<int> ring;
  std::deque<int> deque;
  unsigned random = 1;
  for (int i = 0; i < 5000; ++i) {
    random = random * 1664525u + 1013904223u;
    const unsigned what = random >> 28;  // 0 to 15
    if (what < 9 || deque.empty()) {
      ring.push_back(i);
      deque.push_back(i);
    } else if (what < 14) {
      ring.pop_front();
      deque.pop_front();
    } else {
      ring.pop_back();
      deque.pop_back();
    }
    ASSERT_TRUE(std::equal(ring.begin(), ring.end(), deque.begin(), deque.end())) << i;
  }
}

TEST(Ring, HandsOutWhatLeftWithItsStorage) {
  Ring<std::vector<double>> ring;
  for (int i = 0; i < 8; ++i) ring.Append().assign(100, i);
  const double* storage = ring.front().data();
  ring.pop_front();
  std::vector<double>& again = ring.Append();
  EXPECT_EQ(again.data(), storage);
  EXPECT_GE(again.capacity(), 100u);
  EXPECT_EQ(ring.size(), 8u);
  EXPECT_EQ(ring.front()[0], 1.0);
}

TEST(Ring, KeepsItsElementsAtTheirPlaceUntilItGrows) {
  Ring<int> ring = Counting(0, 8);
  const int* third = &ring[2];
  ring.pop_front();
  ring.push_back(8);
  ring.pop_back();
  ring.push_back(9);
  EXPECT_EQ(&ring[1], third);
  EXPECT_EQ(*third, 2);
}

TEST(Ring, ForgetsItsBackOrEverything) {
  Ring<int> ring = Wrapped(100, 106);
  ring.pop_back();
  EXPECT_EQ(Contents(ring), Range(100, 105));
  ring.push_back(7);
  EXPECT_EQ(ring.back(), 7);
  ring.clear();
  EXPECT_TRUE(ring.empty());
  ring.push_back(1);
  EXPECT_EQ(Contents(ring), Range(1, 2));
}

TEST(Ring, CanBeSearched) {
  for (const Ring<int>& ring : {Wrapped(100, 106), Counting(100, 106), Counting(100, 133)}) {
    const int end = 100 + static_cast<int>(ring.size());
    for (int x = 100; x < end; ++x) {
      const auto at = std::lower_bound(ring.begin(), ring.end(), x);
      EXPECT_EQ(*at, x);
      EXPECT_EQ(std::upper_bound(ring.begin(), ring.end(), x) - at, 1);
    }
    EXPECT_TRUE(std::lower_bound(ring.begin(), ring.end(), 0) == ring.begin());
    auto beyond = std::lower_bound(ring.begin(), ring.end(), end);
    EXPECT_TRUE(beyond == ring.end());
    EXPECT_EQ(*--beyond, end - 1);
  }
}

TEST(Ring, LetsItsElementsBeChanged) {
  Ring<int> ring = Wrapped(100, 106);
  for (int& x : ring) x -= 100;
  ring.front() += 10;
  ring.back() += 20;
  ring[2] += 30;
  EXPECT_EQ(Contents(ring), (std::vector<int>{10, 1, 32, 3, 4, 25}));
}

TEST(Ring, CopiesAreIndependent) {
  Ring<int> ring = Wrapped(100, 106);
  const Ring<int> copy = ring;
  ring.front() = 0;
  ring.pop_back();
  EXPECT_EQ(Contents(copy), Range(100, 106));
}

}  // namespace
}  // namespace test
}  // namespace odmc
