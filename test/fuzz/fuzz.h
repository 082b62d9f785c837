#pragma once

#include <sys/mman.h>
#include <unistd.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <stdexcept>
#include <string>

#include "odmc/sensing/samples.h"

namespace odmc {
namespace fuzz {

/// The bytes of a fuzz target as a file in memory.
class MemoryFile {
 public:
  MemoryFile(const std::uint8_t* data, size_t size)
      : descriptor_(memfd_create("fuzz", MFD_CLOEXEC)) {
    if (descriptor_ < 0 || write(descriptor_, data, size) != static_cast<ssize_t>(size))
      std::abort();
  }
  ~MemoryFile() { close(descriptor_); }
  MemoryFile(const MemoryFile&) = delete;
  MemoryFile& operator=(const MemoryFile&) = delete;

  std::string name() const { return "/proc/self/fd/" + std::to_string(descriptor_); }

 private:
  int descriptor_;
};

/// Calls `read`. Bad input throws std::invalid_argument with a sentence of one printable line; any
/// other exception, and a sentence that is none, ends the target.
template <typename Read>
void ExpectSentence(const Read& read) {
  try {
    read();
  } catch (const std::invalid_argument& e) {
    const std::string sentence = e.what();
    for (const char c : sentence) {
      if (static_cast<unsigned char>(c) < 0x20) {
        std::fprintf(stderr, "a sentence with a control character: %s\n", sentence.c_str());
        std::abort();
      }
    }
    if (sentence.empty()) std::abort();
  }
}

/// Ends the target where a flight has odometry that is not finite, whose attitude is not unit, or
/// whose stamps do not step forward; or rotor speeds that are negative or not finite.
inline void ExpectSound(const FlightLog& log) {
  const OdometrySample* before = nullptr;
  for (const OdometrySample& sample : log.odometry) {
    const bool finite = sample.p_WS.allFinite() && sample.q_WS.coeffs().allFinite() &&
                        (!sample.v_WS || sample.v_WS->allFinite()) &&
                        (!sample.w_WS_S || sample.w_WS_S->allFinite());
    if (!finite || std::abs(sample.q_WS.norm() - 1.0) > 1e-6) std::abort();
    if (before != nullptr && sample.stamp <= before->stamp) std::abort();
    before = &sample;
  }
  for (const RotorSample& sample : log.rotors) {
    if (!sample.speed.allFinite() || !(sample.speed.array() >= 0.0).all()) std::abort();
  }
}

/// Reads `data` with a reader of flights.
template <typename Read>
void ReadFlightBytes(const std::uint8_t* data, size_t size, const Read& read) {
  const MemoryFile file(data, size);
  ExpectSentence([&] { ExpectSound(read(file.name())); });
}

}  // namespace fuzz
}  // namespace odmc
