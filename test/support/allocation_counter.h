#pragma once

// Replaces malloc and its kin in the executable that includes it, for all libraries; operator new
// calls them, too. For one source file of a test only. glibc's free() takes what its __libc_*
// functions gave, so it need not be replaced.

#include <cerrno>
#include <cstddef>

extern "C" {
void* __libc_malloc(std::size_t size);
void* __libc_calloc(std::size_t count, std::size_t size);
void* __libc_realloc(void* old, std::size_t size);
void* __libc_memalign(std::size_t alignment, std::size_t size);
}

namespace odmc {
namespace test {

inline thread_local int living_allocation_counters = 0;
inline thread_local long counted_allocations = 0;

/// Called for every allocation while a counter lives. To find what allocates:
///   gdb -ex 'break odmc::test::CountAllocation' -ex run -ex backtrace <test>
[[gnu::noinline]] inline void CountAllocation() { ++counted_allocations; }

inline void SeeAllocation() {
  if (living_allocation_counters > 0) CountAllocation();
}

/// Counts what this thread takes from the heap while it lives.
class AllocationCounter {
 public:
  AllocationCounter() : before_(counted_allocations) { ++living_allocation_counters; }
  ~AllocationCounter() { --living_allocation_counters; }
  AllocationCounter(const AllocationCounter&) = delete;
  AllocationCounter& operator=(const AllocationCounter&) = delete;

  long count() const { return counted_allocations - before_; }

 private:
  long before_;
};

}  // namespace test
}  // namespace odmc

extern "C" {

void* malloc(std::size_t size) noexcept {
  odmc::test::SeeAllocation();
  return __libc_malloc(size);
}

void* calloc(std::size_t count, std::size_t size) noexcept {
  odmc::test::SeeAllocation();
  return __libc_calloc(count, size);
}

void* realloc(void* old, std::size_t size) noexcept {
  odmc::test::SeeAllocation();
  return __libc_realloc(old, size);
}

void* memalign(std::size_t alignment, std::size_t size) noexcept {
  odmc::test::SeeAllocation();
  return __libc_memalign(alignment, size);
}

void* aligned_alloc(std::size_t alignment, std::size_t size) noexcept {
  return memalign(alignment, size);
}

int posix_memalign(void** result, std::size_t alignment, std::size_t size) noexcept {
  *result = memalign(alignment, size);
  return *result != nullptr ? 0 : ENOMEM;
}

}  // extern "C"
