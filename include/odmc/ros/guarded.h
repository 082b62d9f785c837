#pragma once

#include <mutex>
#include <utility>

namespace odmc {

/// A value that several threads use, one at a time.
template <typename T>
class Guarded {
 public:
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
