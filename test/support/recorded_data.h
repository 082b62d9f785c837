#pragma once

#include <cstdlib>
#include <filesystem>
#include <string>

namespace odmc {
namespace test {

/// Path of a recorded file below $ODMC_DATA_DIR, else ../shared/data beside the checkout; empty if
/// it is on neither (tests that need it then count as skipped).
inline std::string RecordedFile(const std::string& name) {
  namespace fs = std::filesystem;
  const char* environment = std::getenv("ODMC_DATA_DIR");
  const fs::path root = environment != nullptr && *environment != '\0'
                            ? fs::path(environment)
                            : fs::path(ODMC_SOURCE_DIR) / ".." / "shared" / "data";
  const fs::path file = root / name;
  return fs::exists(file) ? file.string() : std::string();
}

}  // namespace test
}  // namespace odmc
