#pragma once

#include <cstdint>
#include <fstream>
#include <string>
#include <string_view>

namespace odmc {

/// Whole content of a file of settings (YAML).
/// @throws std::invalid_argument "FILE: ..." where it cannot be opened, is no regular file (a
/// device
///   or a pipe may never end), has more than 2 MB, or is no text
std::string ReadText(const std::string& file);

/// Reads a text of any length line by line, and holds a block of it.
class LineReader {
 public:
  /// @throws std::invalid_argument "FILE: ..." as ReadText(), whatever the file's length
  explicit LineReader(const std::string& file);

  /// The next line without its end, valid until the next call; false after the last one.
  /// @throws std::invalid_argument where a line has more than 1 MB, or the file is no text
  bool Next(std::string_view* line);

  /// Of the line read last; 1 is the first.
  long number() const { return number_; }

  /// Length of the file when it was opened [bytes].
  std::uint64_t file_bytes() const { return file_bytes_; }

 private:
  bool Fill();

  std::string file_;
  std::ifstream in_;
  std::uint64_t file_bytes_ = 0;
  std::string block_;
  size_t next_ = 0;  // in block_
  long number_ = 0;
};

}  // namespace odmc
