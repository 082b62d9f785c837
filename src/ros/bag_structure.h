#pragma once

#include <cstdint>
#include <string>

namespace odmc {

/// What the records of a sound bag promise.
struct BagStructure {
  std::uint64_t uncompressed_bytes = 0;  ///< of all chunks
};

/// Follows the records of a bag (format 2.0) without its messages, along the way that rosbag will
/// go: file header, index of the end, and for each chunk its header and its indices. Lengths,
/// positions and counts of a damaged bag contradict each other there; the library takes them as
/// they are. Bags of other versions, and bags without an index, are left to the library.
/// @throws std::invalid_argument "FILE: is damaged or truncated: ..." naming the byte
BagStructure CheckBagStructure(const std::string& file);

}  // namespace odmc
