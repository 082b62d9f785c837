#pragma once

#include <cstdint>
#include <functional>
#include <string>

#include "odmc/sensing/samples.h"

namespace odmc {

/// What a child process may use.
struct ChildLimits {
  std::uint64_t memory_bytes = 0;  ///< of address space, beyond what the parent has
  std::uint64_t cpu_s = 0;         ///< of computing time, >= 1
};

/// Sets the limits of the calling process, from what it has used by now on.
void Restrict(const ChildLimits& limits);

/// Runs `read` in a child process and hands its flight over: where a library brings down the
/// process that reads a damaged file, or takes all time or memory there is, it is the child's.
/// What the child writes to the terminal is dropped, and it does not outlive its parent. To be
/// called where no other thread of the process holds a lock: the child is a fork.
/// @param file names the source in errors
/// @throws std::invalid_argument with what `read` throws, whatever its type; and "FILE: ..." where
///   the child crashed or hit a limit; std::runtime_error where there is no process to be had
FlightLog ReadInChild(const std::string& file, const std::function<FlightLog()>& read);

}  // namespace odmc
