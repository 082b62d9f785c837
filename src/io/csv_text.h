#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace odmc {

/// Without blanks and quotes around it.
std::string_view Unquoted(std::string_view cell);

/// Cuts the first cell off a line.
std::string_view NextCell(std::string_view* line);

/// Cuts the first line, without its end, off a text.
std::string_view NextLine(std::string_view* text);

/// Names of a header line.
std::vector<std::string> SplitHeader(std::string_view line);

/// Without the byte order mark some editors write.
std::string_view WithoutMark(std::string_view text);

/// A cell's number, NaN where it is empty.
/// @throws std::invalid_argument "FILE:LINE: column NAME: 'x' is not a number"
double CellNumber(std::string_view cell, const std::string& file, long line,
                  const std::string& column);

}  // namespace odmc
