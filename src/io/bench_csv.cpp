#include "odmc/io/bench_csv.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <map>

#include "csv_text.h"
#include "odmc/text/format.h"
#include "odmc/text/refusal.h"
#include "text_file.h"

namespace odmc {
namespace {

using Strings = std::vector<std::string>;

// A file's columns by name, as they are.
struct Columns {
  std::string file;
  Strings header;
  std::map<std::string, std::vector<double>> values;
  long short_rows = 0;

  bool Has(const std::string& name) const { return values.count(name) > 0; }
};

Columns ReadColumns(const std::string& file) {
  Columns columns;
  columns.file = file;
  LineReader lines(file);
  std::string_view line;
  if (!lines.Next(&line)) RefuseFile(columns.file, "is empty");
  columns.header = SplitHeader(line, file);
  const size_t width = columns.header.size();
  for (const std::string& name : columns.header) columns.values[name];
  while (lines.Next(&line)) {
    if (line.find_first_not_of(" \t") == std::string_view::npos) continue;
    if (static_cast<size_t>(std::count(line.begin(), line.end(), ',')) + 1 != width) {
      ++columns.short_rows;
      continue;
    }
    for (const std::string& name : columns.header)
      columns.values[name].push_back(CellNumber(NextCell(&line), file, lines.number(), name));
  }
  if (columns.values.begin()->second.empty())
    RefuseFile(columns.file, "has a header but no usable row");
  return columns;
}

// "pwm" -> pwm1, pwm2, .. as far as the file has them; "%" stands for the number.
Strings Numbered(const Columns& columns, const std::string& pattern) {
  Strings names;
  const size_t mark = pattern.find('%');
  for (int j = 1;; ++j) {
    std::string name = pattern;
    name.replace(mark, 1, std::to_string(j));
    if (!columns.Has(name)) return names;
    names.push_back(name);
  }
}

// The declared columns, or the first of the usual ones.
Strings Found(const Columns& columns, const Strings& declared, const Strings& usual,
              const std::string& role, const std::string& flag) {
  for (const std::string& name : declared) {
    if (!columns.Has(name)) {
      RefuseFile(columns.file, "column " + name + " (" + role +
                                   ") is missing; found are: " + ListNames(columns.header));
    }
  }
  if (!declared.empty()) return declared;
  Strings silent;
  for (const std::string& name : usual) {
    const Strings names = name.find('%') != std::string::npos ? Numbered(columns, name)
                          : columns.Has(name)                 ? Strings{name}
                                                              : Strings{};
    if (names.empty()) continue;
    // A sensor that was not fitted leaves a column of zeros.
    const std::vector<double>& first = columns.values.at(names.front());
    if (std::any_of(first.begin(), first.end(), [](double x) { return x != 0.0; })) return names;
    if (silent.empty()) silent = names;
  }
  if (!silent.empty() || flag.empty()) return silent;
  RefuseFile(columns.file, "no column is known as " + role + "; declare it by " + flag +
                               ". Found are: " + ListNames(columns.header));
}

Strings FoundOne(const Columns& columns, const std::string& declared, const Strings& usual,
                 const std::string& role) {
  return Found(columns, declared.empty() ? Strings{} : Strings{declared}, usual, role, "");
}

double SpeedFactor(const BenchColumns& columns, const std::string& file) {
  constexpr double kPerRpm = M_PI / 30.0;
  if (columns.speed_unit == SpeedUnit::kRadPerSecond) return 1.0;
  if (columns.speed_unit == SpeedUnit::kRpm) return kPerRpm;
  if (columns.pole_pairs <= 0)
    RefuseFile(file, "speeds in erpm need the motor's number of pole pairs");
  return kPerRpm / columns.pole_pairs;
}

// Rows that are kept: a command, and a time that steps forward where there is one.
std::vector<size_t> UsableRows(const Columns& columns, const Strings& command,
                               const Strings& time) {
  std::vector<size_t> rows;
  double last = -std::numeric_limits<double>::infinity();
  for (size_t i = 0; i < columns.values.at(command.front()).size(); ++i) {
    const bool commanded = std::all_of(command.begin(), command.end(), [&](const std::string& c) {
      return std::isfinite(columns.values.at(c)[i]);
    });
    if (!commanded) continue;
    if (!time.empty()) {
      const double t = columns.values.at(time.front())[i];
      if (!(t > last)) continue;
      last = t;
    }
    rows.push_back(i);
  }
  return rows;
}

std::vector<double> Picked(const std::vector<double>& all, const std::vector<size_t>& rows,
                           double factor) {
  std::vector<double> picked;
  picked.reserve(rows.size());
  for (const size_t i : rows) picked.push_back(factor * all[i]);
  return picked;
}

void CheckThrottle(const BenchRun& run, const std::string& file, const Strings& names) {
  for (size_t k = 0; k < names.size(); ++k) {
    const auto [least, most] = std::minmax_element(run.throttle[k].begin(), run.throttle[k].end());
    if (*least > -0.5 && *most < 1.5) continue;
    RefuseFile(file, "column " + names[k] + " goes from " +
                         std::to_string(CommandOf(*least, run.command_unit)) + " to " +
                         std::to_string(CommandOf(*most, run.command_unit)) +
                         ", which is no command in " + NameOf(run.command_unit));
  }
}

// The columns that are used, by what they hold.
struct Roles {
  Strings time, command, speed, voltage, thrust, torque;

  Strings InWords() const {
    Strings words;
    const auto say = [&words](const std::string& role, const Strings& names) {
      words.push_back(role + ": " + Listed(names, "none"));
    };
    say("time", time);
    say("command", command);
    say("speed", speed);
    say("voltage", voltage);
    say("thrust", thrust);
    say("torque", torque);
    return words;
  }
};

Roles RolesOf(const Columns& columns, const BenchColumns& declared) {
  Roles roles;
  roles.command =
      Found(columns, declared.command,
            {"pwm_us", "pwm%_us", "pwm", "pwm%", "throttle", "throttle%", "command", "command%"},
            "the command", "--command");
  roles.speed = Found(columns, declared.speed,
                      {"rotor%", "rotor_speed", "rotor", "rotor_optical", "rotor_electrical"},
                      "the rotor speed", "--speed");
  if (roles.command.size() != 1 && roles.command.size() != roles.speed.size()) {
    RefuseFile(columns.file, std::to_string(roles.command.size()) + " commands for " +
                                 std::to_string(roles.speed.size()) +
                                 " rotor speeds; one for all or one each is wanted");
  }
  if (!declared.steady_readings) roles.time = FoundOne(columns, declared.time, {"t"}, "the time");
  roles.voltage = FoundOne(columns, declared.voltage, {"vbat"}, "the voltage");
  roles.thrust = FoundOne(columns, declared.thrust, {"thrust_N", "thrust_total_N"}, "the thrust");
  roles.torque = FoundOne(columns, declared.torque, {"torque_Nm"}, "the torque");
  return roles;
}

// Counts the rows, and refuses a file that has too few to use.
void CountRows(const Columns& columns, const Roles& roles, size_t usable, BenchRun* run) {
  const size_t all = columns.values.at(roles.command.front()).size();
  run->rows = static_cast<long>(all) + columns.short_rows;
  run->dropped = run->rows - static_cast<long>(usable);
  if (2 * usable < all)
    RefuseFile(columns.file,
               "only " + std::to_string(usable) + " of " + std::to_string(all) +
                   " rows have a command and a time that steps forward; is there a jump in " +
                   (roles.time.empty() ? "the commands" : "column " + roles.time.front()) + "?");
  if (usable < 10)
    RefuseFile(columns.file, "only " + std::to_string(usable) + " usable rows of " +
                                 std::to_string(run->rows) +
                                 "; time must step forward and commands be numbers");
}

void ReadSpeeds(const Columns& columns, const Roles& roles, const std::vector<size_t>& rows,
                double factor, BenchRun* run) {
  for (const std::string& name : roles.speed) {
    run->speed_rad_s.push_back(Picked(columns.values.at(name), rows, factor));
    for (double& x : run->speed_rad_s.back()) {
      x = std::abs(x);  // a sign only tells the direction of turning
      if (x == 0.0) {
        x = std::numeric_limits<double>::quiet_NaN();
        ++run->zero_speed;
      }
    }
  }
}

void ReadVoltage(const Columns& columns, const Roles& roles, const std::vector<size_t>& rows,
                 BenchRun* run) {
  if (roles.voltage.empty()) return;
  run->voltage_V = Picked(columns.values.at(roles.voltage.front()), rows, 1.0);
  for (double& v : run->voltage_V) {
    if (!(v > 0.0)) v = std::numeric_limits<double>::quiet_NaN();  // not read
  }
  if (std::none_of(run->voltage_V.begin(), run->voltage_V.end(),
                   [](double v) { return std::isfinite(v); }))
    run->voltage_V.clear();
}

}  // namespace

std::optional<SpeedUnit> SpeedUnitNamed(const std::string& name) {
  if (name == "rad_s") return SpeedUnit::kRadPerSecond;
  if (name == "rpm") return SpeedUnit::kRpm;
  if (name == "erpm") return SpeedUnit::kErpm;
  return std::nullopt;
}

BenchRun ReadBenchCsv(const std::string& file, const BenchColumns& declared, Strings* used) {
  const Columns columns = ReadColumns(file);
  const Roles roles = RolesOf(columns, declared);
  BenchRun run;
  run.file = std::filesystem::path(file).filename().string();
  run.command_unit = declared.command_unit;
  const std::vector<size_t> rows = UsableRows(columns, roles.command, roles.time);
  CountRows(columns, roles, rows.size(), &run);
  if (!roles.time.empty()) run.t_s = Picked(columns.values.at(roles.time.front()), rows, 1.0);
  for (const std::string& name : roles.command) {
    run.throttle.push_back(Picked(columns.values.at(name), rows, 1.0));
    for (double& x : run.throttle.back()) x = ThrottleOf(x, declared.command_unit);
  }
  CheckThrottle(run, file, roles.command);
  ReadSpeeds(columns, roles, rows, SpeedFactor(declared, file), &run);
  ReadVoltage(columns, roles, rows, &run);
  if (!roles.thrust.empty())
    run.thrust_N = Picked(columns.values.at(roles.thrust.front()), rows, declared.thrust_unit_N);
  if (!roles.torque.empty())
    run.torque_Nm = Picked(columns.values.at(roles.torque.front()), rows, 1.0);
  if (used != nullptr) {
    const Strings words = roles.InWords();
    used->insert(used->end(), words.begin(), words.end());
  }
  return run;
}

}  // namespace odmc
