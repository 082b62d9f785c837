#pragma once

#include <string>
#include <vector>

namespace odmc {

using TableRow = std::vector<std::string>;

/// A table for a terminal, columns aligned: the first `left` to the left, the others, numbers, to
/// the right.
std::string AlignColumns(const std::vector<TableRow>& rows, size_t left);

}  // namespace odmc
