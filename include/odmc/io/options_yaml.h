#pragma once

#include <string>
#include <vector>

namespace odmc {

/// Reads keys into an options struct through its Visit(); refuses keys nobody asked for. Works for
/// every struct with `template <class V> void Visit(V* v)` that calls `v->Field("key", &member)`
/// for double, int, bool, std::string and Eigen::Vector3d members.
/// @throws std::invalid_argument with a sentence that names file and key.
template <typename Options>
void LoadOptions(const std::string& file, Options* options);

/// Text of every field with its current value, `key: value` a line.
template <typename Options>
std::string FormatOptions(Options options);

}  // namespace odmc

#include "odmc/io/internal/options_yaml_impl.h"
