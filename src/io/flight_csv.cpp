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

#include "csv_table.h"
#include "csv_text.h"
#include "odmc/sensing/flight_checks.h"
#include "odmc/text/format.h"
#include "odmc/text/number_text.h"
#include "odmc/text/printable_text.h"
#include "odmc/text/refusal.h"
#include "text_file.h"

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

// ---- Reading: table to samples -----------------------------------------------------------------

/// Three columns of an optional stream, where the file has them.
class OptionalVector {
 public:
  OptionalVector(const CsvTable& table, const Strings& names) : table_(table), name_(names[0]) {
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
  const CsvTable& table_;
  std::string name_;
  std::optional<CsvTable::Group<3>> columns_;
  RefusedSamples refusals_;
};

/// Poses of a table, with the twist where `with_twist` and the table has it.
std::vector<OdometrySample> ReadOdometry(const CsvTable& table, bool with_twist, FlightLog* log) {
  table.Require(Concatenate({kPosition, kAttitude}));
  const auto p = table.Columns<3>(kPosition);
  const auto q = table.Columns<4>(kAttitude);
  OptionalVector v(table, kVelocity), w(table, kBodyRates);
  std::vector<OdometrySample> samples;
  samples.reserve(table.size());
  RefusedSamples refusals;
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
std::vector<size_t> UsableRows(const CsvTable& table) {
  const auto p = table.Columns<3>(kPosition);
  const auto q = table.Columns<4>(kAttitude);
  std::vector<size_t> rows;
  rows.reserve(table.size());
  for (size_t i = 0; i < table.size(); ++i) {
    if (p.IsFinite(i) && q.IsFinite(i)) rows.push_back(i);
  }
  return rows;
}

std::vector<size_t> AllRows(const CsvTable& table) {
  std::vector<size_t> rows(table.size());
  for (size_t i = 0; i < rows.size(); ++i) rows[i] = i;
  return rows;
}

void ReadImu(const CsvTable& table, const std::vector<size_t>& rows, FlightLog* log) {
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

void ReadBattery(const CsvTable& table, const std::vector<size_t>& rows, FlightLog* log) {
  if (!table.HasAll(kBattery)) return;
  const std::vector<double>& voltage = table.Column("vbat");
  RefusedSamples refusals;
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
std::vector<const std::vector<double>*> RotorData(const CsvTable& table, int num_rotors,
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

void RefuseMoreRotors(const CsvTable& table, int num_rotors) {
  const std::string next = "rotor" + std::to_string(num_rotors + 1);
  const Strings& unknown = table.unknown();
  if (std::find(unknown.begin(), unknown.end(), next) == unknown.end()) return;
  throw std::invalid_argument(table.file() + ": has a column " + next + ", but the vehicle has " +
                              std::to_string(num_rotors) + " rotors");
}

void ReadRotors(const CsvTable& table, const std::vector<size_t>& rows, int num_rotors,
                FlightLog* log) {
  RefuseMoreRotors(table, num_rotors);
  // No sensor: commands may stand in.
  if (!log->commands.empty() && !table.HasAny(Concatenate({RotorColumns(num_rotors), kRotorRms})))
    return;
  const auto columns = RotorData(table, num_rotors, log);
  log->rotors.reserve(rows.size());
  RefusedSamples refusals;
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

void ReadCommands(const CsvTable& table, const std::vector<size_t>& rows, int num_rotors,
                  FlightLog* log) {
  for (const CommandUnit unit : kCommandUnits) {
    const Strings names = CommandColumns(num_rotors, unit);
    if (!table.HasAll(names)) continue;
    log->command_unit = unit;
    RefusedSamples refusals;
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
  return Format("%s%llu.%09llu", negative ? "-" : "", magnitude / 1000000000ULL,
                magnitude % 1000000000ULL);
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
    std::string text = "t," + Listed(names_);
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
    const double share =
        static_cast<double>(stamp - before_stamp) / static_cast<double>(after_stamp - before_stamp);
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
    cells->insert(cells->end(), {s.p_WS.x(), s.p_WS.y(), s.p_WS.z(), q.w(), q.x(), q.y(), q.z()});
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

namespace {

/// Rotor speeds and commands: of the sibling file where there is one.
void ReadActuators(const std::string& file, const CsvTable& table, const std::vector<size_t>& rows,
                   const std::vector<Strings>& commands, int num_rotors, FlightLog* log) {
  const std::string rotor_file = SiblingFile(file, "_rotor.csv");
  if (!std::filesystem::exists(rotor_file)) {
    ReadCommands(table, rows, num_rotors, log);
    ReadRotors(table, rows, num_rotors, log);
    return;
  }
  const CsvTable rotor_table(rotor_file, Concatenate({kTime, RotorColumns(num_rotors), kRotorRms}),
                             commands, log);
  WarnOfUnknown(rotor_table.unknown(), PrintableName(rotor_file), log);
  ReadCommands(rotor_table, AllRows(rotor_table), num_rotors, log);
  if (log->commands.empty()) ReadCommands(table, rows, num_rotors, log);
  ReadRotors(rotor_table, AllRows(rotor_table), num_rotors, log);
}

/// Poses and nothing else; other columns are not named, since they may be another tool's.
FlightLog ReadPosesCsv(const std::string& file) {
  FlightLog log;
  log.file = PrintableName(file);
  const CsvTable table(file, Concatenate({kTime, kPosition, kAttitude, kVelocity, kBodyRates}), {},
                       &log);
  log.odometry = ReadOdometry(table, true, &log);
  return log;
}

}  // namespace

FlightLog ReadFlightCsv(const std::string& file, int num_rotors, PoseSource pose) {
  FlightReadOptions options;
  options.num_rotors = num_rotors;
  options.pose = pose;
  return ReadFlightCsv(file, options);
}

FlightLog ReadFlightCsv(const std::string& file, const FlightReadOptions& options) {
  const std::string mocap_file = SiblingFile(file, "_mocap.csv");
  if (options.part == FlightPart::kPoses) {
    return ReadPosesCsv(options.pose == PoseSource::kMocap ? mocap_file : file);
  }
  FlightLog log;
  log.file = PrintableName(file);
  std::vector<Strings> commands;
  for (const CommandUnit unit : kCommandUnits) {
    commands.push_back(CommandColumns(options.num_rotors, unit));
  }
  CsvTable table(file,
                 Concatenate({kTime, kPosition, kAttitude, kVelocity, kBodyRates, kAccelerometer,
                              kGyro, kBattery, RotorColumns(options.num_rotors), kRotorRms}),
                 commands, &log);
  WarnOfUnknown(table.unknown(), log.file, &log);
  const bool has_poses =
      options.part == FlightPart::kWhole || table.HasAny(Concatenate({kPosition, kAttitude}));
  if (has_poses) log.odometry = ReadOdometry(table, true, &log);
  const std::vector<size_t> rows = has_poses ? UsableRows(table) : AllRows(table);
  table.Release(Concatenate({kTime, kPosition, kAttitude, kVelocity, kBodyRates}));
  ReadImu(table, rows, &log);
  ReadBattery(table, rows, &log);
  ReadActuators(file, table, rows, commands, options.num_rotors, &log);
  TakeSpeedMagnitudes(log.file, &log);
  WarnOfDeadRotors(log.file, &log);

  if (options.pose == PoseSource::kMocap) {
    const CsvTable mocap(mocap_file, Concatenate({kTime, kPosition, kAttitude}), {}, &log);
    WarnOfUnknown(mocap.unknown(), PrintableName(mocap_file), &log);
    UseMocapPoses(ReadOdometry(mocap, false, &log), &log);
  }
  return log;
}

void WriteFlightCsv(const FlightLog& log, const std::string& file) {
  if (log.odometry.empty()) RefuseFile(file, "the flight has no odometry");
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
