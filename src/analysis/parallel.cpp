#include "odmc/analysis/parallel.h"

#include <algorithm>
#include <atomic>
#include <exception>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

namespace odmc {

void ForEachOf(int count, int jobs, const std::function<void(int)>& work,
               const std::function<void(double)>& progress) {
  std::atomic<int> next{0};
  std::mutex mutex;
  // Guarded by the mutex.
  int done = 0;
  std::exception_ptr failure;

  const auto run = [&] {
    for (int i = next++; i < count; i = next++) {
      std::exception_ptr thrown;
      try {
        work(i);
      } catch (...) {
        thrown = std::current_exception();
        next = count;
      }
      const std::lock_guard<std::mutex> lock(mutex);
      if (thrown && !failure) failure = thrown;
      ++done;
      if (progress && !failure) progress(static_cast<double>(done) / count);
    }
  };
  std::vector<std::thread> helpers;
  try {
    for (int j = 1; j < std::min(jobs, count); ++j) helpers.emplace_back(run);
  } catch (const std::system_error&) {
    // No more threads to be had: those there are do the work.
  }
  run();
  for (std::thread& helper : helpers) helper.join();
  if (failure) std::rethrow_exception(failure);
}

}  // namespace odmc
