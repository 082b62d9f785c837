#include "odmc/text/refusal.h"

#include <stdexcept>

namespace odmc {

void RefuseFile(const std::string& file, const std::string& what) {
  throw std::invalid_argument(file + ": " + what);
}

bool Invalid(std::string* error, const std::string& what) {
  if (error != nullptr) *error = what;
  return false;
}

}  // namespace odmc
