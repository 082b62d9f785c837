#include "binary_file.h"

#include <filesystem>
#include <fstream>

#include "odmc/text/refusal.h"

namespace odmc {

std::string ReadBinary(const std::string& file) {
  constexpr std::uintmax_t kMost = std::uintmax_t{1} << 31;
  std::error_code error;
  if (std::filesystem::is_directory(file, error)) RefuseFile(file, "is a folder");
  if (!std::filesystem::is_regular_file(file, error)) RefuseFile(file, "cannot be opened");
  const std::uintmax_t size = std::filesystem::file_size(file, error);
  if (error) RefuseFile(file, "cannot be read");
  if (size == 0) RefuseFile(file, "is empty");
  if (size > kMost) RefuseFile(file, "has more than 2 GB: cut the flight out first");
  std::string bytes(static_cast<size_t>(size), '\0');
  std::ifstream in(file, std::ios::binary);
  if (!in.read(bytes.data(), static_cast<std::streamsize>(size)))
    RefuseFile(file, "cannot be read");
  return bytes;
}

std::string ReadHead(const std::string& file, size_t most) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(file, error)) return "";
  std::string bytes(most, '\0');
  std::ifstream in(file, std::ios::binary);
  in.read(bytes.data(), static_cast<std::streamsize>(most));
  bytes.resize(static_cast<size_t>(in.gcount()));
  return bytes;
}

}  // namespace odmc
