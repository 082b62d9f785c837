#include "csv_text.h"

#include <algorithm>
#include <limits>
#include <stdexcept>

#include "odmc/io/number_text.h"

namespace odmc {

std::string_view Unquoted(std::string_view cell) {
  const auto is_wrapping = [](char c) { return c == ' ' || c == '\t' || c == '\r' || c == '"'; };
  while (!cell.empty() && is_wrapping(cell.front())) cell.remove_prefix(1);
  while (!cell.empty() && is_wrapping(cell.back())) cell.remove_suffix(1);
  return cell;
}

std::string_view NextCell(std::string_view* line) {
  const size_t comma = line->find(',');
  const std::string_view cell = line->substr(0, comma);
  line->remove_prefix(comma == std::string_view::npos ? line->size() : comma + 1);
  return cell;
}

std::string_view NextLine(std::string_view* text) {
  const size_t end = text->find('\n');
  std::string_view line = text->substr(0, end);
  text->remove_prefix(end == std::string_view::npos ? text->size() : end + 1);
  if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
  return line;
}

std::vector<std::string> SplitHeader(std::string_view line) {
  std::vector<std::string> names;
  const size_t cells = 1 + static_cast<size_t>(std::count(line.begin(), line.end(), ','));
  for (size_t i = 0; i < cells; ++i) names.emplace_back(Unquoted(NextCell(&line)));
  return names;
}

std::string_view WithoutMark(std::string_view text) {
  if (text.substr(0, 3) == "\xEF\xBB\xBF") text.remove_prefix(3);
  return text;
}

double CellNumber(std::string_view cell, const std::string& file, long line,
                  const std::string& column) {
  const std::string_view text = Unquoted(cell);
  double number = std::numeric_limits<double>::quiet_NaN();
  if (!text.empty() && !ParseNumber(text, &number)) {
    throw std::invalid_argument(file + ":" + std::to_string(line) + ": column " + column + ": '" +
                                std::string(text) + "' is not a number");
  }
  return number;
}

}  // namespace odmc
