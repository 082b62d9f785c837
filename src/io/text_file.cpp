#include "text_file.h"

#include <filesystem>

#include "csv_text.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

// Covariances of 128 parameters, the most a model may have, are 0.4 MB.
constexpr size_t kMostSettings = 2 << 20;
constexpr size_t kBlock = 1 << 20;
constexpr size_t kLongestLine = 1 << 20;  // of numbers: 50000 columns

/// Opens a regular file. @returns its length
std::uint64_t OpenRegular(const std::string& file, std::ifstream* in) {
  std::error_code error;
  const auto status = std::filesystem::status(file, error);
  if (std::filesystem::is_directory(status)) RefuseFile(file, "is a folder");
  if (std::filesystem::exists(status) && !std::filesystem::is_regular_file(status)) {
    RefuseFile(file, "is no regular file (a device or a pipe)");
  }
  in->open(file, std::ios::binary);
  const auto bytes = std::filesystem::file_size(file, error);
  if (!*in || error) RefuseFile(file, "cannot be opened");
  return bytes;
}

/// Refuses what text editors do not write.
void CheckIsText(const std::string& file, std::string_view block) {
  if (block.find('\0') == std::string_view::npos) return;
  RefuseFile(file, "holds zero bytes and is no text; a text in UTF-16 must be saved as UTF-8");
}

}  // namespace

std::string ReadText(const std::string& file) {
  std::ifstream in;
  OpenRegular(file, &in);
  std::string text(kMostSettings + 1, '\0');
  in.read(text.data(), static_cast<std::streamsize>(text.size()));
  text.resize(static_cast<size_t>(in.gcount()));
  if (text.size() > kMostSettings)
    RefuseFile(file, "is too long; a file of settings has at most 2 MB");
  CheckIsText(file, text);
  return text;
}

LineReader::LineReader(const std::string& file)
    : file_(file), file_bytes_(OpenRegular(file, &in_)) {}

bool LineReader::Fill() {
  block_.erase(0, next_);
  next_ = 0;
  const size_t kept = block_.size();
  if (kept > kLongestLine) {
    RefuseFile(file_, "line " + std::to_string(number_ + 1) +
                          " has more than 1 MB; this is no table of numbers");
  }
  block_.resize(kept + kBlock);
  in_.read(block_.data() + kept, kBlock);
  block_.resize(kept + static_cast<size_t>(in_.gcount()));
  const std::string_view added = std::string_view(block_).substr(kept);
  CheckIsText(file_, added);
  return !added.empty();
}

bool LineReader::Next(std::string_view* line) {
  size_t end = block_.find('\n', next_);
  while (end == std::string::npos && Fill()) end = block_.find('\n', next_);
  if (next_ == block_.size()) return false;
  *line = std::string_view(block_).substr(next_, end == std::string::npos ? end : end - next_);
  next_ = end == std::string::npos ? block_.size() : end + 1;
  if (!line->empty() && line->back() == '\r') line->remove_suffix(1);
  if (++number_ == 1) *line = WithoutMark(*line);
  return true;
}

}  // namespace odmc
