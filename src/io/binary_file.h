#pragma once

#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>

namespace odmc {

/// Whole content of a binary file.
/// @throws std::invalid_argument "FILE: ..." where it cannot be opened, is no regular file, is
/// empty
///   or has more than 2 GB
std::string ReadBinary(const std::string& file);

/// The first `most` bytes of a file; empty where it cannot be read.
std::string ReadHead(const std::string& file, size_t most);

/// Takes little-endian values off a block of bytes. Reading past the end gives zeros and sets
/// ended(), so that a caller may look once per record.
class ByteReader {
 public:
  explicit ByteReader(std::string_view bytes, size_t position = 0)
      : bytes_(bytes), position_(position) {}

  size_t position() const { return position_; }
  size_t left() const { return bytes_.size() - position_; }
  bool ended() const { return ended_; }  ///< true once something was read past the end

  void MoveTo(size_t position) {
    position_ = position < bytes_.size() ? position : bytes_.size();
    ended_ = false;
  }

  std::uint8_t Byte() {
    if (position_ >= bytes_.size()) {
      ended_ = true;
      return 0;
    }
    return static_cast<std::uint8_t>(bytes_[position_++]);
  }

  /// The next `count` bytes; fewer where the block ends.
  std::string_view Take(size_t count) {
    if (count > left()) {
      ended_ = true;
      count = left();
    }
    position_ += count;
    return bytes_.substr(position_ - count, count);
  }

  template <typename Value>
  Value Number() {
    Value value{};
    const std::string_view raw = Take(sizeof value);
    if (raw.size() == sizeof value) std::memcpy(&value, raw.data(), sizeof value);
    return value;
  }

 private:
  std::string_view bytes_;
  size_t position_ = 0;
  bool ended_ = false;
};

}  // namespace odmc
