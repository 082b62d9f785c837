#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "odmc/sensing/flight_checks.h"
#include "odmc/sensing/samples.h"
#include "odmc/text/refusal.h"

namespace odmc {

/// A file's name without its folder, fit to print.
std::string PrintableName(const std::string& file);

/// Rows of the wanted columns of one CSV file, in time order.
class CsvTable {
 public:
  using Strings = std::vector<std::string>;

  /// Reads the columns of `wanted` that the file has, and those of each group of `whole` that it
  /// has all of; the names of others go to unknown().
  CsvTable(const std::string& file, const Strings& wanted, const std::vector<Strings>& whole,
           FlightLog* log);

  const std::string& file() const { return file_; }
  std::string name() const { return PrintableName(file_); }  ///< for warnings
  size_t size() const { return stamps_.size(); }
  Stamp stamp(size_t row) const { return stamps_[row]; }
  std::string Where(size_t row) const { return "line " + std::to_string(lines_[row]); }
  const Strings& unknown() const { return unknown_; }

  bool HasAll(const Strings& names) const { return CountOf(names) == names.size(); }
  bool HasAny(const Strings& names) const { return CountOf(names) > 0; }
  /// Refuses a file that has only some columns of a group.
  void CheckAllOrNone(const Strings& names) const;
  /// @throws std::invalid_argument naming those that are missing
  void Require(const Strings& names) const;

  /// Columns by name, to read rows with.
  template <int N>
  struct Group {
    std::array<const std::vector<double>*, N> columns;
    bool IsFinite(size_t row) const {
      return std::all_of(columns.begin(), columns.end(),
                         [row](const auto* c) { return std::isfinite((*c)[row]); });
    }
    double operator()(int i, size_t row) const { return (*columns[i])[row]; }
  };
  template <int N>
  Group<N> Columns(const Strings& names) const {
    Group<N> group;
    for (int i = 0; i < N; ++i) group.columns[i] = &values_.at(names[i]);
    return group;
  }
  const std::vector<double>& Column(const std::string& name) const { return values_.at(name); }

  /// Gives the room of columns back that nobody needs any more.
  void Release(const Strings& names) {
    for (const std::string& name : names) {
      const auto found = values_.find(name);
      if (found != values_.end()) std::vector<double>().swap(found->second);
    }
  }

 private:
  size_t CountOf(const Strings& names) const {
    return std::count_if(names.begin(), names.end(),
                         [&](const std::string& n) { return values_.count(n) > 0; });
  }
  void ReadHeader(std::string_view line, Strings wanted, const std::vector<Strings>& whole);
  /// Makes room, which costs nothing before it is used, so that no column is ever copied.
  void Reserve(size_t rows);
  void ReadRow(std::string_view line, long number);
  /// Takes back the last row, whose time leapt ahead.
  void DropLast();
  void CheckSteps() const;

  std::string file_;
  std::map<std::string, std::vector<double>> values_;
  std::vector<Stamp> stamps_;
  std::vector<long> lines_;
  Strings header_, unknown_;
  std::vector<std::vector<double>*> targets_;  // by column of the file, null where not wanted
  std::vector<double> row_;
  size_t time_column_ = 0;
  RefusedSamples short_rows_, no_time_, leaps_, out_of_order_;
};

}  // namespace odmc
