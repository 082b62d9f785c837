#include "csv_table.h"

#include <cstdint>
#include <filesystem>
#include <limits>
#include <utility>

#include "csv_text.h"
#include "odmc/math/statistics.h"
#include "odmc/text/format.h"
#include "odmc/text/number_text.h"
#include "odmc/text/printable_text.h"
#include "text_file.h"

namespace odmc {
namespace {

using Strings = std::vector<std::string>;

/// Nanoseconds of seconds in plain decimals, exactly: a double of seconds since 1970 is 0.2 µs off.
/// @returns false for any other notation.
bool ParsePlainSeconds(std::string_view text, Stamp* stamp) {
  const bool negative = !text.empty() && text.front() == '-';
  if (negative) text.remove_prefix(1);
  const size_t point = std::min(text.find('.'), text.size());
  if (point == 0 || point > 10 || text.size() > point + 10) return false;
  std::uint64_t value = 0;  // of 19 digits; a stamp holds most of them
  int decimals = 0;
  for (size_t i = 0; i < text.size(); ++i) {
    if (i == point) continue;
    if (text[i] < '0' || text[i] > '9') return false;
    value = 10 * value + static_cast<std::uint64_t>(text[i] - '0');
    if (i > point) ++decimals;
  }
  for (; decimals < 9; ++decimals) value *= 10;
  if (value > static_cast<std::uint64_t>(std::numeric_limits<Stamp>::max())) return false;
  *stamp = negative ? -static_cast<Stamp>(value) : static_cast<Stamp>(value);
  return true;
}

constexpr double kLatest_s = 9e9;  // what int64 nanoseconds hold

}  // namespace

std::string PrintableName(const std::string& file) {
  return Printable(std::filesystem::path(file).filename().string());
}

CsvTable::CsvTable(const std::string& file, const Strings& wanted,
                   const std::vector<Strings>& whole, FlightLog* log)
    : file_(file) {
  LineReader lines(file);
  std::string_view line;
  if (!lines.Next(&line) || line.find_first_not_of(" \t") == std::string_view::npos) {
    RefuseFile(file_, "is empty, or its first line is");
  }
  ReadHeader(line, wanted, whole);
  while (lines.Next(&line)) {
    if (line.find_first_not_of(" \t") == std::string_view::npos) continue;
    if (lines.number() == 2)
      Reserve(lines.file_bytes() / std::max(line.size(), 2 * header_.size()));
    ReadRow(line, lines.number());
  }
  const auto rows = static_cast<size_t>(out_of_order_.count) + size();
  if (static_cast<size_t>(no_time_.count) > rows) {
    RefuseFile(file_, "column t is no time in " + std::to_string(no_time_.count) + " of " +
                          std::to_string(rows + static_cast<size_t>(no_time_.count)) +
                          " rows (first: " + no_time_.first + ")");
  }
  if (rows == 0) RefuseFile(file_, "has a header but no usable row");
  if (2 * size() < rows) {
    RefuseFile(file_, "column t steps back or repeats in " + std::to_string(out_of_order_.count) +
                          " of " + std::to_string(rows) + " rows (first: " + out_of_order_.first +
                          ")");
  }
  CheckSteps();
  short_rows_.Report(name(), "rows that do not have as many cells as the header", log);
  no_time_.Report(name(), "rows without a finite t", log);
  leaps_.Report(name(), "rows whose t leaps ahead of all after it", log);
  out_of_order_.Report(name(), "rows whose t steps back or repeats", log);
}

void CsvTable::ReadHeader(std::string_view line, Strings wanted,
                          const std::vector<Strings>& whole) {
  while (!line.empty() && (line.front() == '#' || line.front() == ' ')) line.remove_prefix(1);
  header_ = SplitHeader(line, file_);
  for (const Strings& group : whole) {
    const bool has_all = std::all_of(group.begin(), group.end(), [this](const std::string& name) {
      return std::find(header_.begin(), header_.end(), name) != header_.end();
    });
    if (has_all) wanted.insert(wanted.end(), group.begin(), group.end());
  }
  if (header_.size() == 1 && header_[0].find_first_of(";\t") != std::string::npos) {
    RefuseFile(file_, "line 1: columns must be separated by commas");
  }
  if (std::find(header_.begin(), header_.end(), "t") == header_.end()) {
    RefuseFile(file_, "column t is missing; found are: " + ListNames(header_));
  }
  for (size_t i = 0; i < header_.size(); ++i) {
    const std::string& name = header_[i];
    const bool is_wanted = std::find(wanted.begin(), wanted.end(), name) != wanted.end();
    if (name == "t") time_column_ = i;
    if (!is_wanted && !name.empty()) unknown_.push_back(name);
    targets_.push_back(is_wanted ? &values_[name] : nullptr);
  }
  row_.resize(header_.size());
}

void CsvTable::Reserve(size_t rows) {
  stamps_.reserve(rows);
  lines_.reserve(rows);
  for (auto& [name, values] : values_) values.reserve(rows);
}

void CsvTable::ReadRow(std::string_view line, long number) {
  const auto cells = static_cast<size_t>(std::count(line.begin(), line.end(), ',')) + 1;
  if (cells != header_.size()) {  // cut off while writing: even its last number may be
    short_rows_.Add("line " + std::to_string(number));
    return;
  }
  Stamp stamp = 0;
  bool is_exact = false;
  for (size_t i = 0; i < header_.size(); ++i) {
    const std::string_view raw = NextCell(&line);
    if (targets_[i] == nullptr) continue;
    row_[i] = CellNumber(raw, file_, number, header_[i]);
    if (i == time_column_) is_exact = ParsePlainSeconds(Unquoted(raw), &stamp);
  }
  const double t = row_[time_column_];
  if (!(std::abs(t) < kLatest_s)) {
    no_time_.Add("line " + std::to_string(number));
    return;
  }
  if (!is_exact) stamp = FromSeconds(t);
  if (IsLoneLeap(stamps_, stamp)) DropLast();
  if (!stamps_.empty() && stamp <= stamps_.back()) {
    out_of_order_.Add("line " + std::to_string(number) + ", t " + FormatNumber(t));
    return;
  }
  stamps_.push_back(stamp);
  lines_.push_back(number);
  for (size_t i = 0; i < targets_.size(); ++i) {
    if (targets_[i] != nullptr) targets_[i]->push_back(row_[i]);
  }
}

void CsvTable::DropLast() {
  leaps_.Add("line " + std::to_string(lines_.back()) + ", t " +
             FormatNumber(ToSeconds(stamps_.back())));
  stamps_.pop_back();
  lines_.pop_back();
  for (auto* target : targets_) {
    if (target != nullptr) target->pop_back();
  }
}

namespace {

/// Flights are recorded at 5 to 5000 Hz.
std::string UnitOfSteps(double step) {
  constexpr double kLongest_s = 0.2;
  if (step < 1e3 * kLongest_s) return "milliseconds";
  return step < 1e6 * kLongest_s ? "microseconds" : "nanoseconds or ticks";
}

}  // namespace

/// Milliseconds or ticks in place of seconds are not a flight.
void CsvTable::CheckSteps() const {
  if (size() < 3) return;
  std::vector<Stamp> steps;
  for (size_t i = 1; i < size(); ++i) steps.push_back(stamps_[i] - stamps_[i - 1]);
  const double step = ToSeconds(MiddleOf(std::move(steps)));
  if (step > 1.0) {
    RefuseFile(file_, "column t steps by " + FormatNumber(step) +
                          " s; is it in seconds? It looks like " + UnitOfSteps(step));
  }
}

void CsvTable::CheckAllOrNone(const Strings& names) const {
  if (HasAny(names)) Require(names);
}

void CsvTable::Require(const Strings& names) const {
  Strings missing;
  for (const std::string& name : names) {
    if (values_.count(name) == 0) missing.push_back(name);
  }
  if (missing.empty()) return;
  RefuseFile(file_, std::string(missing.size() == 1 ? "column " : "columns ") + Listed(missing) +
                        (missing.size() == 1 ? " is" : " are") +
                        " missing; found are: " + ListNames(header_));
}

}  // namespace odmc
