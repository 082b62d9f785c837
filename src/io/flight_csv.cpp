#include "odmc/io/flight_csv.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <limits>
#include <map>
#include <optional>
#include <set>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "csv_text.h"
#include "odmc/io/number_text.h"
#include "odmc/io/printable_text.h"
#include "odmc/sensing/flight_checks.h"
#include "text_file.h"
#include "yaml_reader.h"

namespace odmc {
namespace {

using Strings = std::vector<std::string>;

const Strings kTime = {"t"};
const Strings kPosition = {"px", "py", "pz"};
const Strings kAttitude = {"qw", "qx", "qy", "qz"};
const Strings kVelocity = {"vx", "vy", "vz"};
const Strings kBodyRates = {"wx", "wy", "wz"};
const Strings kAccelerometer = {"ax", "ay", "az"};
const Strings kGyro = {"gx", "gy", "gz"};
const Strings kBattery = {"vbat"};
const Strings kRotorRms = {"rotor_rms"};

Strings RotorColumns(int num_rotors) {
  Strings names;
  for (int j = 1; j <= num_rotors; ++j) names.push_back("rotor" + std::to_string(j));
  return names;
}

/// Columns of commands in this unit: the name declares it.
Strings CommandColumns(int num_rotors, CommandUnit unit) {
  Strings names;
  for (int j = 1; j <= num_rotors; ++j) {
    const std::string number = std::to_string(j);
    names.push_back(unit == CommandUnit::kMicroseconds ? "pwm" + number + "_us"
                    : unit == CommandUnit::kRaw16      ? "pwm" + number
                                                       : "throttle" + number);
  }
  return names;
}
constexpr CommandUnit kCommandUnits[] = {CommandUnit::kMicroseconds, CommandUnit::kRaw16,
                                         CommandUnit::kFraction};

Strings Concatenate(std::initializer_list<Strings> lists) {
  Strings all;
  for (const Strings& list : lists) all.insert(all.end(), list.begin(), list.end());
  return all;
}

// ---- Reading: text to a table of numbers -------------------------------------------------------

/// Nanoseconds of seconds in plain decimals, exactly: a double of seconds since 1970 is 0.2 µs off.
/// @returns false for any other notation.
bool ParsePlainSeconds(std::string_view text, Stamp* stamp) {
  const bool negative = !text.empty() && text.front() == '-';
  if (negative) text.remove_prefix(1);
  const size_t point = std::min(text.find('.'), text.size());
  if (point == 0 || point > 10 || text.size() > point + 10) return false;
  Stamp value = 0;
  int decimals = 0;
  for (size_t i = 0; i < text.size(); ++i) {
    if (i == point) continue;
    if (text[i] < '0' || text[i] > '9') return false;
    value = 10 * value + (text[i] - '0');
    if (i > point) ++decimals;
  }
  for (; decimals < 9; ++decimals) value *= 10;
  *stamp = negative ? -value : value;
  return true;
}

constexpr double kLatest_s = 9e9;  // what int64 nanoseconds hold

std::string FileName(const std::string& file) {
  return Printable(std::filesystem::path(file).filename().string());
}

/// Rows of the wanted columns of one CSV file, in time order.
class Table {
 public:
  /// Reads the columns of `wanted` that the file has, and those of each group of `whole` that it
  /// has all of; the names of others go to unknown().
  Table(const std::string& file, const Strings& wanted, const std::vector<Strings>& whole,
        FlightLog* log);

  const std::string& file() const { return file_; }
  std::string name() const { return FileName(file_); }  ///< for warnings
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
  [[noreturn]] void Fail(const std::string& what) const {
    throw std::invalid_argument(file_ + ": " + what);
  }

  std::string file_;
  std::map<std::string, std::vector<double>> values_;
  std::vector<Stamp> stamps_;
  std::vector<long> lines_;
  Strings header_, unknown_;
  std::vector<std::vector<double>*> targets_;  // by column of the file, null where not wanted
  std::vector<double> row_;
  size_t time_column_ = 0;
  Refusals short_rows_, no_time_, leaps_, out_of_order_;
};

Table::Table(const std::string& file, const Strings& wanted, const std::vector<Strings>& whole,
             FlightLog* log)
    : file_(file) {
  LineReader lines(file);
  std::string_view line;
  if (!lines.Next(&line) || line.find_first_not_of(" \t") == std::string_view::npos) {
    Fail("is empty, or its first line is");
  }
  ReadHeader(line, wanted, whole);
  while (lines.Next(&line)) {
    if (line.find_first_not_of(" \t") == std::string_view::npos) continue;
    if (lines.number() == 2) Reserve(lines.file_bytes() / std::max(line.size(), 2 * header_.size()));
    ReadRow(line, lines.number());
  }
  const auto rows = static_cast<size_t>(out_of_order_.count) + size();
  if (static_cast<size_t>(no_time_.count) > rows) {
    Fail("column t is no time in " + std::to_string(no_time_.count) + " of " +
         std::to_string(rows + static_cast<size_t>(no_time_.count)) + " rows (first: " +
         no_time_.first + ")");
  }
  if (rows == 0) Fail("has a header but no usable row");
  if (2 * size() < rows) {
    Fail("column t steps back or repeats in " + std::to_string(out_of_order_.count) + " of " +
         std::to_string(rows) + " rows (first: " + out_of_order_.first + ")");
  }
  CheckSteps();
  short_rows_.Report(name(), "rows that do not have as many cells as the header", log);
  no_time_.Report(name(), "rows without a finite t", log);
  leaps_.Report(name(), "rows whose t leaps ahead of all after it", log);
  out_of_order_.Report(name(), "rows whose t steps back or repeats", log);
}

void Table::ReadHeader(std::string_view line, Strings wanted, const std::vector<Strings>& whole) {
  header_ = SplitHeader(line, file_);
  for (const Strings& group : whole) {
    const bool has_all = std::all_of(group.begin(), group.end(), [this](const std::string& name) {
      return std::find(header_.begin(), header_.end(), name) != header_.end();
    });
    if (has_all) wanted.insert(wanted.end(), group.begin(), group.end());
  }
  if (header_.size() == 1 && header_[0].find_first_of(";\t") != std::string::npos) {
    Fail("line 1: columns must be separated by commas");
  }
  if (std::find(header_.begin(), header_.end(), "t") == header_.end()) {
    Fail("column t is missing; found are: " + ListNames(header_));
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

void Table::Reserve(size_t rows) {
  stamps_.reserve(rows);
  lines_.reserve(rows);
  for (auto& [name, values] : values_) values.reserve(rows);
}

void Table::ReadRow(std::string_view line, long number) {
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

void Table::DropLast() {
  leaps_.Add("line " + std::to_string(lines_.back()) + ", t " +
             FormatNumber(ToSeconds(stamps_.back())));
  stamps_.pop_back();
  lines_.pop_back();
  for (auto* target : targets_) {
    if (target != nullptr) target->pop_back();
  }
}

/// Milliseconds or ticks in place of seconds are not a flight.
void Table::CheckSteps() const {
  if (size() < 3) return;
  std::vector<Stamp> steps;
  for (size_t i = 1; i < size(); ++i) steps.push_back(stamps_[i] - stamps_[i - 1]);
  std::nth_element(steps.begin(), steps.begin() + steps.size() / 2, steps.end());
  const double step = ToSeconds(steps[steps.size() / 2]);
  if (step > 1.0) Fail("column t steps by " + FormatNumber(step) + " s; is it in seconds?");
}

void Table::CheckAllOrNone(const Strings& names) const {
  if (HasAny(names)) Require(names);
}

void Table::Require(const Strings& names) const {
  Strings missing;
  for (const std::string& name : names) {
    if (values_.count(name) == 0) missing.push_back(name);
  }
  if (missing.empty()) return;
  Fail(std::string(missing.size() == 1 ? "column " : "columns ") + JoinNames(missing) +
       (missing.size() == 1 ? " is" : " are") + " missing; found are: " + ListNames(header_));
}

// ---- Reading: table to samples -----------------------------------------------------------------

/// Three columns of an optional stream, where the file has them.
class OptionalVector {
 public:
  OptionalVector(const Table& table, const Strings& names) : table_(table), name_(names[0]) {
    table.CheckAllOrNone(names);
    if (table.HasAll(names)) columns_ = table.Columns<3>(names);
  }
  bool present() const { return columns_.has_value(); }
  std::optional<Eigen::Vector3d> At(size_t row) {
    if (!columns_) return std::nullopt;
    if (!columns_->IsFinite(row)) {
      refusals_.Add(table_.Where(row));
      return std::nullopt;
    }
    return Eigen::Vector3d((*columns_)(0, row), (*columns_)(1, row), (*columns_)(2, row));
  }
  void Report(FlightLog* log) const {
    refusals_.Report(table_.name(),
                     "samples of " + name_ + " and its neighbours that are not finite", log);
  }

 private:
  const Table& table_;
  std::string name_;
  std::optional<Table::Group<3>> columns_;
  Refusals refusals_;
};

/// Poses of a table, with the twist where `with_twist` and the table has it.
std::vector<OdometrySample> ReadOdometry(const Table& table, bool with_twist, FlightLog* log) {
  table.Require(Concatenate({kPosition, kAttitude}));
  const auto p = table.Columns<3>(kPosition);
  const auto q = table.Columns<4>(kAttitude);
  OptionalVector v(table, kVelocity), w(table, kBodyRates);
  std::vector<OdometrySample> samples;
  samples.reserve(table.size());
  Refusals refusals;
  for (size_t i = 0; i < table.size(); ++i) {
    if (!p.IsFinite(i) || !q.IsFinite(i)) {
      refusals.Add(table.Where(i));
      continue;
    }
    OdometrySample sample;
    sample.stamp = table.stamp(i);
    sample.p_WS << p(0, i), p(1, i), p(2, i);
    sample.q_WS = Eigen::Quaterniond(q(0, i), q(1, i), q(2, i), q(3, i));
    if (with_twist) {
      sample.v_WS = v.At(i);
      sample.w_WS_S = w.At(i);
    }
    samples.push_back(sample);
  }
  refusals.Report(table.name(), "rows whose pose is not finite", log);
  v.Report(log);
  w.Report(log);
  if (samples.empty()) throw std::invalid_argument(table.file() + ": no row has a finite pose");
  NormaliseAttitudes(table.file(), &samples, log);
  return samples;
}

/// A row whose pose is not usable is refused whole; these are the rows that stay.
std::vector<size_t> UsableRows(const Table& table) {
  const auto p = table.Columns<3>(kPosition);
  const auto q = table.Columns<4>(kAttitude);
  std::vector<size_t> rows;
  rows.reserve(table.size());
  for (size_t i = 0; i < table.size(); ++i) {
    if (p.IsFinite(i) && q.IsFinite(i)) rows.push_back(i);
  }
  return rows;
}

std::vector<size_t> AllRows(const Table& table) {
  std::vector<size_t> rows(table.size());
  for (size_t i = 0; i < rows.size(); ++i) rows[i] = i;
  return rows;
}

void ReadImu(const Table& table, const std::vector<size_t>& rows, FlightLog* log) {
  OptionalVector a(table, kAccelerometer), g(table, kGyro);
  if (!a.present() && !g.present()) return;
  log->imu.reserve(rows.size());
  for (const size_t i : rows) {
    const ImuSample sample{table.stamp(i), g.At(i), a.At(i)};
    if (sample.gyro_I || sample.specific_force_I) log->imu.push_back(sample);
  }
  a.Report(log);
  g.Report(log);
}

void ReadBattery(const Table& table, const std::vector<size_t>& rows, FlightLog* log) {
  if (!table.HasAll(kBattery)) return;
  const std::vector<double>& voltage = table.Column("vbat");
  Refusals refusals;
  for (const size_t i : rows) {
    if (std::isfinite(voltage[i])) {
      log->battery.push_back({table.stamp(i), voltage[i]});
    } else {
      refusals.Add(table.Where(i));
    }
  }
  refusals.Report(table.name(), "samples of vbat that are not finite", log);
}

/// The rotors' columns: one each or, where single ones are missing, the RMS for all.
std::vector<const std::vector<double>*> RotorData(const Table& table, int num_rotors,
                                                  FlightLog* log) {
  const Strings names = RotorColumns(num_rotors);
  std::vector<const std::vector<double>*> columns;
  log->rotor_rms_only = !table.HasAll(names) && table.HasAll(kRotorRms);
  if (!log->rotor_rms_only) table.Require(names);
  for (const std::string& name : names) {
    columns.push_back(&table.Column(log->rotor_rms_only ? kRotorRms[0] : name));
  }
  return columns;
}

void RefuseMoreRotors(const Table& table, int num_rotors) {
  const std::string next = "rotor" + std::to_string(num_rotors + 1);
  const Strings& unknown = table.unknown();
  if (std::find(unknown.begin(), unknown.end(), next) == unknown.end()) return;
  throw std::invalid_argument(table.file() + ": has a column " + next + ", but the vehicle has " +
                              std::to_string(num_rotors) + " rotors");
}

void ReadRotors(const Table& table, const std::vector<size_t>& rows, int num_rotors,
                FlightLog* log) {
  RefuseMoreRotors(table, num_rotors);
  // No sensor: commands may stand in.
  if (!log->commands.empty() && !table.HasAny(Concatenate({RotorColumns(num_rotors), kRotorRms})))
    return;
  const auto columns = RotorData(table, num_rotors, log);
  log->rotors.reserve(rows.size());
  Refusals refusals;
  for (const size_t i : rows) {
    RotorSample sample;
    sample.stamp = table.stamp(i);
    sample.speed.resize(num_rotors);
    for (int j = 0; j < num_rotors; ++j) sample.speed[j] = (*columns[j])[i];
    if (sample.speed.allFinite()) {
      log->rotors.push_back(sample);
    } else {
      refusals.Add(table.Where(i));
    }
  }
  refusals.Report(table.name(), "rotor samples that are not finite", log);
  if (log->rotors.empty()) throw std::invalid_argument(table.file() + ": no usable rotor speeds");
}

void ReadCommands(const Table& table, const std::vector<size_t>& rows, int num_rotors,
                  FlightLog* log) {
  for (const CommandUnit unit : kCommandUnits) {
    const Strings names = CommandColumns(num_rotors, unit);
    if (!table.HasAll(names)) continue;
    log->command_unit = unit;
    Refusals refusals;
    for (const size_t i : rows) {
      CommandSample sample{table.stamp(i), RotorVector(num_rotors)};
      for (int j = 0; j < num_rotors; ++j)
        sample.throttle[j] = ThrottleOf(table.Column(names[static_cast<size_t>(j)])[i], unit);
      if (sample.throttle.allFinite()) {
        log->commands.push_back(sample);
      } else {
        refusals.Add(table.Where(i));
      }
    }
    refusals.Report(table.name(), "commands that are not finite", log);
    return;
  }
}

void WarnOfUnknown(const Strings& unknown, const std::string& file, FlightLog* log) {
  if (!unknown.empty()) {
    log->warnings.push_back(file + ": unknown columns ignored: " + ListNames(unknown));
  }
}

// ---- Writing -----------------------------------------------------------------------------------

/// Seconds with all nine decimals, exactly.
std::string FormatStamp(Stamp stamp) {
  const bool negative = stamp < 0;
  const auto magnitude = static_cast<unsigned long long>(negative ? -stamp : stamp);
  char text[40];
  std::snprintf(text, sizeof text, "%s%llu.%09llu", negative ? "-" : "", magnitude / 1000000000ULL,
                magnitude % 1000000000ULL);
  return text;
}

/// Cells of one row at a stamp; nan is an empty cell. Rows come in the order of their stamps.
using Cells = std::vector<double>;
using Filler = std::function<void(Stamp stamp, size_t row, Cells* cells)>;

/// Columns that fill rows as they are written.
class TableWriter {
 public:
  void Add(const Strings& names, Filler fill) {
    names_.insert(names_.end(), names.begin(), names.end());
    fillers_.push_back(std::move(fill));
  }

  /// One row per sample of `rows`, at its stamp.
  template <typename Sample>
  void Write(const std::vector<Sample>& rows, const std::string& file) const {
    constexpr size_t kBuffer = 1 << 16;
    std::ofstream out(file, std::ios::binary);
    std::string text = "t," + JoinNames(names_);
    text.erase(std::remove(text.begin(), text.end(), ' '), text.end());
    Cells cells;
    for (size_t i = 0; i < rows.size(); ++i) {
      cells.clear();
      for (const Filler& fill : fillers_) fill(rows[i].stamp, i, &cells);
      text += "\n" + FormatStamp(rows[i].stamp);
      for (const double cell : cells) text += std::isnan(cell) ? "," : "," + FormatNumber(cell);
      if (text.size() < kBuffer) continue;
      out << text;
      text.clear();
    }
    out << text << "\n";
    out.close();
    if (!out) throw std::runtime_error(file + ": cannot be written");
  }

 private:
  Strings names_;
  std::vector<Filler> fillers_;
};

constexpr double kNoValue = std::numeric_limits<double>::quiet_NaN();

/// Goes through a stream beside rows whose stamps step forward.
template <typename Sample>
class Cursor {
 public:
  explicit Cursor(const std::vector<Sample>& samples) : samples_(samples) {}

  /// The sample at `stamp`, null if there is none.
  const Sample* At(Stamp stamp) {
    Advance(stamp);
    return next_ < samples_.size() && samples_[next_].stamp == stamp ? &samples_[next_] : nullptr;
  }

 protected:
  /// To the first sample that is not before `stamp`.
  void Advance(Stamp stamp) {
    while (next_ < samples_.size() && samples_[next_].stamp < stamp) ++next_;
  }

  const std::vector<Sample>& samples_;
  size_t next_ = 0;
};

/// Values that some samples have: as they are where the stamps agree, else (if `resample`) linear
/// between neighbours, nothing outside.
template <typename Sample, typename Get>
class Resampled {
 public:
  Resampled(const std::vector<Sample>& samples, Get get, bool resample)
      : samples_(samples), get_(get), resample_(resample) {}

  std::optional<Eigen::Vector3d> At(Stamp stamp) {
    for (; next_ < samples_.size(); ++next_) {
      const bool has_value = get_(samples_[next_]).has_value();
      if (has_value && samples_[next_].stamp >= stamp) break;
      if (has_value) before_ = next_;
    }
    if (next_ == samples_.size()) return std::nullopt;
    const Stamp after_stamp = samples_[next_].stamp;
    if (after_stamp == stamp) return get_(samples_[next_]);
    if (!resample_ || !before_) return std::nullopt;
    const Stamp before_stamp = samples_[*before_].stamp;
    const double share = static_cast<double>(stamp - before_stamp) /
                         static_cast<double>(after_stamp - before_stamp);
    const Eigen::Vector3d low = *get_(samples_[*before_]), high = *get_(samples_[next_]);
    return low + share * (high - low);
  }

 private:
  const std::vector<Sample>& samples_;
  Get get_;
  bool resample_;
  size_t next_ = 0;               // the first one from the stamp on with a value
  std::optional<size_t> before_;  // the last one before with a value
};

/// Adds three columns of what `get` takes from each sample (an optional vector), if any has it.
template <typename Sample, typename Get>
void AddVector(const Strings& names, const std::vector<Sample>& samples, Get get, bool resample,
               TableWriter* table) {
  if (std::none_of(samples.begin(), samples.end(),
                   [&](const Sample& sample) { return get(sample).has_value(); })) {
    return;
  }
  table->Add(names, [stream = Resampled(samples, get, resample)](Stamp stamp, size_t,
                                                                 Cells* cells) mutable {
    const auto value = stream.At(stamp);
    for (int axis = 0; axis < 3; ++axis) cells->push_back(value ? (*value)[axis] : kNoValue);
  });
}

/// True if every stamp of `part` is one of those of `all`.
template <typename Part, typename All>
bool IsSubset(const std::vector<Part>& part, const std::vector<All>& all) {
  Cursor<All> stamps(all);
  return std::all_of(part.begin(), part.end(),
                     [&](const Part& sample) { return stamps.At(sample.stamp) != nullptr; });
}

void AddOdometry(const FlightLog& log, TableWriter* table) {
  table->Add(Concatenate({kPosition, kAttitude}), [&log](Stamp, size_t row, Cells* cells) {
    const OdometrySample& s = log.odometry[row];
    const Eigen::Quaterniond& q = s.q_WS;
    cells->insert(cells->end(),
                  {s.p_WS.x(), s.p_WS.y(), s.p_WS.z(), q.w(), q.x(), q.y(), q.z()});
  });
  AddVector(
      kVelocity, log.odometry, [](const OdometrySample& s) { return s.v_WS; }, false, table);
  AddVector(
      kBodyRates, log.odometry, [](const OdometrySample& s) { return s.w_WS_S; }, false, table);
}

void AddImu(const FlightLog& log, TableWriter* table) {
  const bool resample = !IsSubset(log.imu, log.odometry);
  AddVector(
      kAccelerometer, log.imu, [](const ImuSample& s) { return s.specific_force_I; }, resample,
      table);
  AddVector(
      kGyro, log.imu, [](const ImuSample& s) { return s.gyro_I; }, resample, table);
}

void AddRotors(const FlightLog& log, TableWriter* table) {
  if (log.rotors.empty()) return;
  const auto num_rotors = static_cast<int>(log.rotors[0].speed.size());
  const Strings names = log.rotor_rms_only ? kRotorRms : RotorColumns(num_rotors);
  table->Add(names, [rotors = Cursor(log.rotors), count = names.size()](Stamp stamp, size_t,
                                                                        Cells* cells) mutable {
    const RotorSample* const sample = rotors.At(stamp);
    for (size_t j = 0; j < count; ++j) {
      cells->push_back(sample == nullptr ? kNoValue : sample->speed[static_cast<int>(j)]);
    }
  });
}

// At the nearest stamp before where they have others.
void AddCommands(const FlightLog& log, TableWriter* table) {
  if (log.commands.empty()) return;
  const auto num_rotors = static_cast<int>(log.commands.front().throttle.size());
  table->Add(CommandColumns(num_rotors, log.command_unit),
             [&log, num_rotors, next = size_t{0}](Stamp stamp, size_t, Cells* cells) mutable {
               while (next < log.commands.size() && log.commands[next].stamp <= stamp) ++next;
               for (int j = 0; j < num_rotors; ++j) {
                 cells->push_back(
                     next == 0 ? kNoValue
                               : CommandOf(log.commands[next - 1].throttle[j], log.command_unit));
               }
             });
}

void AddBattery(const FlightLog& log, TableWriter* table) {
  if (log.battery.empty()) return;
  const auto get = [](const BatterySample& s) {
    return std::optional<Eigen::Vector3d>(Eigen::Vector3d(s.voltage_V, 0.0, 0.0));
  };
  table->Add(kBattery, [stream = Resampled(log.battery, get, true)](Stamp stamp, size_t,
                                                                    Cells* cells) mutable {
    const auto value = stream.At(stamp);
    cells->push_back(value ? value->x() : kNoValue);
  });
}

}  // namespace

std::string SiblingFile(const std::string& file, const std::string& suffix) {
  const std::filesystem::path path(file);
  return (path.parent_path() / (path.stem().string() + suffix)).string();
}

FlightLog ReadFlightCsv(const std::string& file, int num_rotors, PoseSource pose) {
  FlightLog log;
  log.file = FileName(file);
  const Strings rotors = Concatenate({RotorColumns(num_rotors), kRotorRms});
  std::vector<Strings> commands;
  for (const CommandUnit unit : kCommandUnits) commands.push_back(CommandColumns(num_rotors, unit));
  Table table(file,
              Concatenate({kTime, kPosition, kAttitude, kVelocity, kBodyRates, kAccelerometer,
                           kGyro, kBattery, rotors}),
              commands, &log);
  WarnOfUnknown(table.unknown(), log.file, &log);
  log.odometry = ReadOdometry(table, true, &log);
  const std::vector<size_t> rows = UsableRows(table);
  table.Release(Concatenate({kTime, kPosition, kAttitude, kVelocity, kBodyRates}));
  ReadImu(table, rows, &log);
  ReadBattery(table, rows, &log);

  const std::string rotor_file = SiblingFile(file, "_rotor.csv");
  if (std::filesystem::exists(rotor_file)) {
    const Table rotor_table(rotor_file, Concatenate({kTime, rotors}), commands, &log);
    WarnOfUnknown(rotor_table.unknown(), FileName(rotor_file), &log);
    ReadCommands(rotor_table, AllRows(rotor_table), num_rotors, &log);
    if (log.commands.empty()) ReadCommands(table, rows, num_rotors, &log);
    ReadRotors(rotor_table, AllRows(rotor_table), num_rotors, &log);
  } else {
    ReadCommands(table, rows, num_rotors, &log);
    ReadRotors(table, rows, num_rotors, &log);
  }
  TakeSpeedMagnitudes(log.file, &log);
  WarnOfDeadRotors(log.file, &log);

  if (pose == PoseSource::kMocap) {
    const std::string mocap_file = SiblingFile(file, "_mocap.csv");
    const Table mocap(mocap_file, Concatenate({kTime, kPosition, kAttitude}), {}, &log);
    WarnOfUnknown(mocap.unknown(), FileName(mocap_file), &log);
    UseMocapPoses(ReadOdometry(mocap, false, &log), &log);
  }
  return log;
}

void WriteFlightCsv(const FlightLog& log, const std::string& file) {
  if (log.odometry.empty()) throw std::invalid_argument(file + ": the flight has no odometry");
  TableWriter table;
  AddOdometry(log, &table);
  AddImu(log, &table);
  const std::string rotor_file = SiblingFile(file, "_rotor.csv");
  if (IsSubset(log.rotors, log.odometry)) {
    AddRotors(log, &table);
    AddCommands(log, &table);
    std::filesystem::remove(rotor_file);
  } else {
    TableWriter rotor_table;
    AddRotors(log, &rotor_table);
    AddCommands(log, &rotor_table);
    rotor_table.Write(log.rotors, rotor_file);
  }
  AddBattery(log, &table);
  table.Write(log.odometry, file);
}

}  // namespace odmc
