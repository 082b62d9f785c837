#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace odmc {

/// Without blanks and quotes around it.
std::string_view Unquoted(std::string_view cell);

/// Cuts the first cell off a line.
std::string_view NextCell(std::string_view* line);

/// Names of a header line.
/// @throws std::invalid_argument "FILE: line 1: ..." where it has more than 1000 columns, or two of
///   the same name (empty ones may repeat)
std::vector<std::string> SplitHeader(std::string_view line, const std::string& file);

/// "a, b, c and 7 more", fit to print.
std::string ListNames(const std::vector<std::string>& names);

/// Without the byte order mark some editors write.
std::string_view WithoutMark(std::string_view text);

/// A cell's number, NaN where it is empty.
/// @throws std::invalid_argument "FILE:LINE: column NAME: 'x' is not a number"
double CellNumber(std::string_view cell, const std::string& file, long line,
                  const std::string& column);

}  // namespace odmc
