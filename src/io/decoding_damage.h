#pragma once

#include <cstddef>

namespace odmc {

/// How well a log's bytes could be decoded.
struct DecodingDamage {
  long places = 0;     ///< where decoding had to start anew
  size_t first = 0;    ///< byte of the first one
  size_t skipped = 0;  ///< bytes
  bool is_cut_off = false;

  /// Decoding failed at the byte `from` and starts anew at `to`.
  void Note(size_t from, size_t to) {
    if (places++ == 0) first = from;
    skipped += to - from;
  }
};

}  // namespace odmc
