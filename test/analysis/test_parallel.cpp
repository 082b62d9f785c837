#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <stdexcept>
#include <thread>
#include <vector>

#include "odmc/analysis/parallel.h"

namespace odmc {
namespace test {
namespace {

TEST(ForEachOf, DoesEachOnce) {
  for (const int jobs : {1, 2, 7}) {
    std::vector<std::atomic<int>> done(40);
    double share = 0.0;
    ForEachOf(
        40, jobs, [&](int i) { ++done[static_cast<size_t>(i)]; },
        [&](double is) {
          EXPECT_GT(is, share);
          share = is;
        });
    for (const auto& times : done) EXPECT_EQ(times, 1) << jobs;
    EXPECT_EQ(share, 1.0);
  }
  ForEachOf(0, 3, [](int) { FAIL(); });
}

TEST(ForEachOf, StaysOnItsThreadWhereItIsOne) {
  const std::thread::id here = std::this_thread::get_id();
  ForEachOf(5, 1, [&](int) { EXPECT_EQ(std::this_thread::get_id(), here); });
}

TEST(ForEachOf, ThrowsWhatFailsAndBeginsNoMore) {
  for (const int jobs : {1, 3}) {
    std::atomic<int> begun{0};
    const auto work = [&](int i) {
      ++begun;
      if (i == 2) throw std::runtime_error("the third");
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    };
    EXPECT_THROW(ForEachOf(1000, jobs, work), std::runtime_error);
    EXPECT_LT(begun, 1000);
  }
}

}  // namespace
}  // namespace test
}  // namespace odmc
