#pragma once

#include <functional>

namespace odmc {

/// Calls `work` for 0..count-1 on up to `jobs` threads, this one among them, and `progress` (if
/// given) with the share done, from one thread at a time. After a failure no new work begins.
/// @throws whatever `work` threw first
void ForEachOf(int count, int jobs, const std::function<void(int)>& work,
               const std::function<void(double)>& progress = {});

}  // namespace odmc
