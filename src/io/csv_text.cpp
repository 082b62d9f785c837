#include "csv_text.h"

#include <algorithm>
#include <limits>
#include <set>
#include <stdexcept>

#include "odmc/text/number_text.h"
#include "odmc/text/printable_text.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

/// Enough of a cell to find it.
std::string Excerpt(std::string_view cell) { return Printable(cell, 40); }

}  // namespace

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

std::vector<std::string> SplitHeader(std::string_view line, const std::string& file) {
  constexpr size_t kMostColumns = 1000;  // autopilots log some hundred
  const size_t cells = 1 + static_cast<size_t>(std::count(line.begin(), line.end(), ','));
  if (cells > kMostColumns) {
    RefuseFile(file, "line 1: " + std::to_string(cells) + " columns; at most " +
                         std::to_string(kMostColumns) + " are read");
  }
  std::vector<std::string> names;
  std::set<std::string> seen;
  for (size_t i = 0; i < cells; ++i) {
    names.emplace_back(Unquoted(NextCell(&line)));
    if (!names.back().empty() && !seen.insert(names.back()).second) {
      RefuseFile(file, "line 1: column " + Excerpt(names.back()) + " is there twice");
    }
  }
  return names;
}

std::string ListNames(const std::vector<std::string>& names) {
  constexpr size_t kMost = 40;
  std::string text;
  for (size_t i = 0; i < names.size() && i < kMost; ++i) {
    text += (i == 0 ? "" : ", ") + Excerpt(names[i]);
  }
  if (names.size() > kMost) text += " and " + std::to_string(names.size() - kMost) + " more";
  return text;
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
    throw std::invalid_argument(file + ":" + std::to_string(line) + ": column " + Excerpt(column) +
                                ": '" + Excerpt(text) + "' is not a number");
  }
  return number;
}

}  // namespace odmc
