#pragma once

#include <string>

namespace odmc {

/// What a reader does with a file that it can't use: throws std::invalid_argument "FILE: WHAT".
[[noreturn]] void RefuseFile(const std::string& file, const std::string& what);

/// What IsValid() does with a value that it can't use: `*error = what`, unless `error` is null.
/// @returns false
bool Invalid(std::string* error, const std::string& what);

}  // namespace odmc
