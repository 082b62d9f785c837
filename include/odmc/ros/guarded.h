#pragma once

#include <condition_variable>
#include <mutex>
#include <utility>

namespace odmc {

/// A value that several threads use, one at a time.
template <typename T>
class Guarded {
 public:
  /// Makes the value of these arguments.
  template <typename... Arguments>
  explicit Guarded(Arguments&&... arguments) : value_(std::forward<Arguments>(arguments)...) {}

  /// Calls `use(T*)` under the lock. @returns what it returns
  template <typename Use>
  auto With(const Use& use) {
    const std::lock_guard<std::mutex> lock(mutex_);
    return use(&value_);
  }

  /// The same unless another thread has it. @returns whether it was called
  template <typename Use>
  bool TryWith(const Use& use) {
    const std::unique_lock<std::mutex> lock(mutex_, std::try_to_lock);
    if (lock.owns_lock()) use(&value_);
    return lock.owns_lock();
  }

  /// Waits until `is_true(T*)`, but no longer than `longest`; asks under the lock, at first and
  /// whenever `changed` is notified. @returns whether it is true
  template <typename Duration, typename Condition>
  bool WaitFor(std::condition_variable* changed, Duration longest, const Condition& is_true) {
    std::unique_lock<std::mutex> lock(mutex_);
    return changed->wait_for(lock, longest, [&] { return is_true(&value_); });
  }

  void Set(T value) {
    With([&](T* guarded) { *guarded = std::move(value); });
  }
  T Get() {
    return With([](T* guarded) { return *guarded; });
  }

 private:
  std::mutex mutex_;
  T value_;
};

}  // namespace odmc
