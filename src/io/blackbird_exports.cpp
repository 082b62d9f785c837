#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <map>

#include "csv_table.h"
#include "csv_text.h"
#include "odmc/io/data_sets.h"
#include "odmc/sensing/flight_checks.h"
#include "odmc/text/number_text.h"
#include "odmc/text/printable_text.h"
#include "odmc/text/refusal.h"
#include "text_file.h"

namespace odmc {
namespace {

using Strings = std::vector<std::string>;

constexpr Stamp kSecond = 1000000000;

/// Cells of a line; commas within quotes belong to their cell.
Strings SplitQuoted(std::string_view line) {
  Strings cells(1);
  bool is_quoted = false;
  for (const char c : line) {
    if (c == '"') {
      is_quoted = !is_quoted;
    } else if (c == ',' && !is_quoted) {
      cells.emplace_back();
    } else {
      cells.back() += c;
    }
  }
  for (std::string& cell : cells) cell = std::string(Unquoted(cell));
  return cells;
}

/// A name without a comment sign and without the running number that a spreadsheet adds (x.1).
std::string CleanName(std::string name) {
  while (!name.empty() && (name.front() == '#' || name.front() == ' ')) name.erase(0, 1);
  const size_t point = name.rfind('.');
  const bool is_numbered = point != std::string::npos && point + 1 < name.size() &&
                           name.find_first_not_of("0123456789", point + 1) == std::string::npos;
  return is_numbered ? name.substr(0, point) : name;
}

/// Exports have one column per line of the printed message, so names repeat: each is taken together
/// with the field it belongs to ("angular_velocity, x" is angular_velocity.x, the k-th stamp of a
/// list sample_stamp.k.secs). '-' stays for columns that carry no value.
Strings QualifiedNames(const Strings& header) {
  static const Strings kContainers = {"header",       "stamp",
                                      "pose",         "position",
                                      "orientation",  "angular_velocity",
                                      "sample_stamp", "linear_acceleration"};
  static const Strings kParts = {"x", "y", "z", "w", "secs", "nsecs"};
  const auto is_in = [](const Strings& list, const std::string& name) {
    return std::find(list.begin(), list.end(), name) != list.end();
  };
  Strings names;
  std::string field;
  int entry = -1;
  for (const std::string& raw : header) {
    const std::string name = CleanName(raw);
    if (is_in(kContainers, name)) field = name;
    if (field == "sample_stamp" && (name == "secs" || name == "nsecs")) {
      if (name == "secs") ++entry;
      names.push_back("sample_stamp." + std::to_string(entry) + "." + name);
    } else {
      names.push_back(is_in(kParts, name) ? field + "." + name : name);
    }
  }
  return names;
}

/// One row's wanted cells.
class Row {
 public:
  Row(const std::string& file, long line, Strings names, Strings cells)
      : file_(file), line_(line), names_(std::move(names)), cells_(std::move(cells)) {}

  double Number(size_t i) const { return Parse(cells_[i], names_[i]); }

  /// A printed list, as [1.0, 2.0].
  std::vector<double> List(size_t i) const {
    std::string inner;
    for (const char c : cells_[i]) {
      if (c != '[' && c != ']' && c != '(' && c != ')') inner += c;
    }
    std::vector<double> values;
    std::string_view rest = inner;
    while (!rest.empty()) values.push_back(Parse(std::string(NextCell(&rest)), names_[i]));
    return values;
  }

  /// From the cells of seconds and of nanoseconds.
  Stamp StampAt(size_t i) const { return Whole(i) * kSecond + Whole(i + 1); }

 private:
  double Parse(const std::string& cell, const std::string& name) const {
    double value = 0.0;
    if (ParseNumber(Unquoted(cell), &value)) return value;
    RefuseFile(file_, "line " + std::to_string(line_) + ": column '" + name + "': cannot read '" +
                          Printable(cell, 40) + "' as a number");
  }
  Stamp Whole(size_t i) const {
    const std::string& cell = cells_[i];
    if (cell.empty() || cell.size() > 10 ||
        cell.find_first_not_of("0123456789") != std::string::npos) {
      RefuseFile(file_, "line " + std::to_string(line_) +
                            ": columns 'secs', 'nsecs': cannot read '" + Printable(cell, 20) +
                            "' as a stamp");
    }
    return std::atoll(cell.c_str());
  }

  const std::string& file_;
  long line_;
  Strings names_, cells_;
};

/// One exported topic.
class Export {
 public:
  explicit Export(std::string file) : file_(std::move(file)), lines_(file_) {
    std::string_view line;
    if (!lines_.Next(&line)) RefuseFile(file_, "is empty");
    names_ = QualifiedNames(SplitQuoted(line));
    for (const std::string& name : names_) {
      if (name != "-") plain_.push_back(name);
    }
  }

  const std::string& file() const { return file_; }
  const Strings& names() const { return plain_; }

  void ForRows(const Strings& wanted, FlightLog* log, const std::function<void(const Row&)>& use) {
    const std::vector<size_t> columns = Find(wanted);
    RefusedSamples refusals;
    std::string_view line;
    while (lines_.Next(&line)) {
      if (line.find_first_not_of(" \t,") == std::string_view::npos) continue;
      Strings cells = SplitQuoted(line);
      if (cells.size() == names_.size()) cells = WithValues(cells);
      if (cells.size() != plain_.size()) {
        refusals.Add("line " + std::to_string(lines_.number()));
        continue;
      }
      Strings picked;
      for (const size_t column : columns) picked.push_back(cells[column]);
      use(Row(file_, lines_.number(), wanted, std::move(picked)));
    }
    refusals.Report(PrintableName(file_), "rows with fewer or more cells than the header", log);
  }

 private:
  std::vector<size_t> Find(const Strings& wanted) const {
    std::vector<size_t> columns;
    std::string missing;
    for (const std::string& name : wanted) {
      const auto found = std::find(plain_.begin(), plain_.end(), name);
      if (found == plain_.end()) missing += (missing.empty() ? "'" : ", '") + name + "'";
      columns.push_back(static_cast<size_t>(found - plain_.begin()));
    }
    if (!missing.empty()) RefuseFile(file_, "line 1: missing column " + missing);
    return columns;
  }
  Strings WithValues(const Strings& cells) const {
    Strings kept;
    for (size_t i = 0; i < cells.size(); ++i) {
      if (names_[i] != "-") kept.push_back(cells[i]);
    }
    return kept;
  }

  std::string file_;
  LineReader lines_;
  Strings names_, plain_;  // of all columns, of those with values
};

// ---- Streams -----------------------------------------------------------------------------------

const Strings kStamp = {"stamp.secs", "stamp.nsecs"};

Strings WithStamp(const Strings& names) {
  Strings all = kStamp;
  all.insert(all.end(), names.begin(), names.end());
  return all;
}

void ReadState(const std::string& file, FlightLog* log, BlackbirdFlight* flight) {
  Export(file).ForRows(
      WithStamp({"position.x", "position.y", "position.z", "orientation.w", "orientation.x",
                 "orientation.y", "orientation.z"}),
      log, [&](const Row& row) {
        flight->poses.push_back({row.StampAt(0),
                                 {row.Number(2), row.Number(3), row.Number(4)},
                                 {row.Number(5), row.Number(6), row.Number(7), row.Number(8)}});
      });
}

void ReadImu(const std::string& file, FlightLog* log, BlackbirdFlight* flight) {
  Export(file).ForRows(
      WithStamp({"angular_velocity.x", "angular_velocity.y", "angular_velocity.z",
                 "linear_acceleration.x", "linear_acceleration.y", "linear_acceleration.z"}),
      log, [&](const Row& row) {
        ImuSample sample;
        sample.stamp = row.StampAt(0);
        sample.gyro_I = Eigen::Vector3d(row.Number(2), row.Number(3), row.Number(4));
        sample.specific_force_I = Eigen::Vector3d(row.Number(5), row.Number(6), row.Number(7));
        flight->imu.push_back(sample);
      });
}

/// Exports of the first version have no sample_stamp: the header's stands for all.
void ReadRotors(const std::string& file, FlightLog* log, BlackbirdFlight* flight) {
  Export rotors(file);
  Strings wanted = WithStamp({"rpm"});
  for (const std::string& name : rotors.names()) {
    const bool is_stamp = name.rfind("sample_stamp.", 0) == 0 && name != "sample_stamp.-1.nsecs";
    if (is_stamp) wanted.push_back(name);
  }
  rotors.ForRows(wanted, log, [&](const Row& row) {
    BlackbirdFlight::RotorMessage message;
    message.rpm = row.List(2);
    for (size_t i = 3; i + 1 < wanted.size(); i += 2) message.stamps.push_back(row.StampAt(i));
    if (message.stamps.empty()) message.stamps.assign(message.rpm.size(), row.StampAt(0));
    if (message.rpm.empty() || message.stamps.size() != message.rpm.size()) {
      RefuseFile(file, std::to_string(message.stamps.size()) + " stamps for " +
                           std::to_string(message.rpm.size()) + " rotor speeds");
    }
    flight->rotors.push_back(std::move(message));
  });
}

void ReadCommands(const std::string& file, FlightLog* log, BlackbirdFlight* flight) {
  Export(file).ForRows(WithStamp({"pwm"}), log, [&](const Row& row) {
    flight->commands.push_back({row.StampAt(0), row.List(2)});
  });
}

// ---- groundTruthPoses.csv ----------------------------------------------------------------------

/// Nanoseconds of a time since 1970 whose unit (s, ms, us, ns) is told by its size; digits of whole
/// numbers are kept exactly.
Stamp EpochStamp(const std::string& text, double value) {
  const bool is_whole =
      text.find_first_not_of("0123456789") == std::string::npos && text.size() < 19;
  for (const auto& [limit, scale] :
       {std::pair{1e17, Stamp{1}}, {1e14, Stamp{1000}}, {1e11, Stamp{1000000}}}) {
    if (value < limit) continue;
    return is_whole ? std::atoll(text.c_str()) * scale
                    : static_cast<Stamp>(std::llround(value * static_cast<double>(scale)));
  }
  if (!(std::abs(value) < 9e9)) return 0;
  const double whole = std::floor(value);
  const size_t point = text.find('.');
  double fraction = value - whole;
  if (point != std::string::npos) ParseNumber("0" + text.substr(point), &fraction);
  return static_cast<Stamp>(whole) * kSecond + FromSeconds(fraction);
}

const std::vector<Strings> kPoseNames = {{"timestamp", "time", "t"},
                                         {"x", "px", "p_x", "tx"},
                                         {"y", "py", "p_y", "ty"},
                                         {"z", "pz", "p_z", "tz"},
                                         {"qw", "q_w"},
                                         {"qx", "q_x"},
                                         {"qy", "q_y"},
                                         {"qz", "q_z"}};

/// Columns by the header; in the documented order where the file has none.
std::vector<size_t> PoseColumns(const std::string& file, const Strings& first) {
  double number = 0.0;
  std::vector<size_t> columns;
  if (ParseNumber(first.front(), &number)) {
    for (size_t i = 0; i < kPoseNames.size(); ++i) columns.push_back(i);
    return columns;
  }
  for (const Strings& choices : kPoseNames) {
    size_t column = first.size();
    for (size_t i = 0; i < first.size(); ++i) {
      std::string name = CleanName(first[i]);
      for (char& c : name) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
      if (std::find(choices.begin(), choices.end(), name) != choices.end())
        column = std::min(column, i);
    }
    if (column == first.size())
      RefuseFile(file, "line 1: missing column '" + choices.front() + "'");
    columns.push_back(column);
  }
  return columns;
}

void ReadGroundTruth(const std::string& file, FlightLog* log, BlackbirdFlight* flight) {
  LineReader lines(file);
  std::vector<size_t> columns;
  RefusedSamples refusals;
  std::string_view line;
  while (lines.Next(&line)) {
    const Strings cells = SplitQuoted(line);
    if (columns.empty()) {
      columns = PoseColumns(file, cells);
      double number = 0.0;
      if (!ParseNumber(cells.front(), &number)) continue;
    }
    if (line.find_first_not_of(" \t,") == std::string_view::npos) continue;
    if (cells.size() <= *std::max_element(columns.begin(), columns.end())) {
      refusals.Add("line " + std::to_string(lines.number()));
      continue;
    }
    std::array<double, 8> v{};
    for (size_t i = 0; i < v.size(); ++i) {
      if (ParseNumber(cells[columns[i]], &v[i])) continue;
      RefuseFile(file, "line " + std::to_string(lines.number()) + ": column '" +
                           kPoseNames[i].front() + "': cannot read '" +
                           Printable(cells[columns[i]], 40) + "' as a number");
    }
    flight->poses.push_back(
        {EpochStamp(cells[columns[0]], v[0]), {v[1], v[2], v[3]}, {v[4], v[5], v[6], v[7]}});
  }
  refusals.Report(PrintableName(file), "rows with fewer or more cells than the header", log);
}

/// In the folder or its subfolder csv; empty where it is in neither.
std::string FileOf(const std::string& folder, const Strings& names) {
  std::error_code ignored;
  for (const char* sub : {"", "csv"}) {
    for (const std::string& name : names) {
      const auto path = std::filesystem::path(folder) / sub / name;
      if (std::filesystem::is_regular_file(path, ignored)) return path.string();
    }
  }
  return "";
}

std::string ExportOf(const std::string& folder, const std::string& topic) {
  return FileOf(folder,
                {"blackbird_slash_" + topic + ".csv", "_slash_blackbird_slash_" + topic + ".csv"});
}

}  // namespace

bool IsBlackbirdFolder(const std::string& folder) {
  for (const char* topic : {"state", "rotor_rpm", "imu", "pwm"}) {
    if (!ExportOf(folder, topic).empty()) return true;
  }
  return false;
}

FlightLog ReadBlackbird(const std::string& folder, const FlightReadOptions& options) {
  const std::string state = ExportOf(folder, "state"), rotors = ExportOf(folder, "rotor_rpm"),
                    imu = ExportOf(folder, "imu"), pwm = ExportOf(folder, "pwm"),
                    truth = FileOf(folder, {"groundTruthPoses.csv"});
  if (state.empty() && truth.empty()) {
    RefuseFile(folder,
               "neither blackbird_slash_state.csv nor groundTruthPoses.csv, here or in csv/");
  }
  if (rotors.empty()) RefuseFile(folder, "no blackbird_slash_rotor_rpm.csv, here or in csv/");
  FlightLog log;
  log.file = PrintableName(folder);
  BlackbirdFlight flight;
  flight.path = folder;
  state.empty() ? ReadGroundTruth(truth, &log, &flight) : ReadState(state, &log, &flight);
  if (!imu.empty()) ReadImu(imu, &log, &flight);
  ReadRotors(rotors, &log, &flight);
  if (!pwm.empty()) ReadCommands(pwm, &log, &flight);
  ConvertBlackbird(std::move(flight), options, &log);
  return log;
}

}  // namespace odmc
