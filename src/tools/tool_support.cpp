#include "tool_support.h"

#include <glob.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <set>

#include "odmc/analysis/report.h"
#include "odmc/effects/effects.h"
#include "odmc/identification/flight_actuator.h"
#include "odmc/inspection/join_odometry.h"
#include "odmc/inspection/recording_inspection.h"
#include "odmc/inspection/rotor_units.h"
#include "odmc/io/actuator_yaml.h"
#include "odmc/io/options_yaml.h"
#include "odmc/io/parameters_yaml.h"
#include "odmc/sensing/plausible.h"
#include "odmc/text/number_text.h"
#include "odmc/text/printable_text.h"
#include "odmc/trajectory/trajectory.h"

namespace odmc::tools {
namespace {

namespace fs = std::filesystem;

constexpr char kExitStatus[] = "Exit status: 0 success, 1 bad input, 2 usage.";
constexpr char kLogEndings[] = ".bfl, .bbl, .ulg, .bin";
constexpr char kPython[] = "/usr/bin/python3";

std::string OneLine(std::string text) {
  while (!text.empty() && text.back() == '\n') text.pop_back();
  std::replace(text.begin(), text.end(), '\n', ' ');
  return Printable(text);
}

int Fail(const std::string& text, int status) {
  std::cerr << "error: " << OneLine(text) << "\n";
  return status;
}

/// Visitor that sets one field from text.
class OptionSetter {
 public:
  OptionSetter(std::string key, std::string text) : key_(std::move(key)), text_(std::move(text)) {}

  void Field(const std::string& key, double* value) {
    if (Takes(key) && !ParseNumber(text_, value)) Refuse("a number");
  }
  void Field(const std::string& key, int* value) {
    if (!Takes(key)) return;
    double number = 0.0;
    if (!ParseNumber(text_, &number) || !(std::abs(number) < 1e9) || number != std::round(number)) {
      Refuse("an integer");
    }
    *value = static_cast<int>(number);
  }
  void Field(const std::string& key, bool* value) {
    if (!Takes(key)) return;
    if (text_ != "true" && text_ != "false") Refuse("true or false");
    *value = text_ == "true";
  }
  void Field(const std::string& key, std::string* value) {
    if (Takes(key)) *value = text_;
  }

  bool found() const { return found_; }

 private:
  bool Takes(const std::string& key) {
    found_ = found_ || key == key_;
    return key == key_;
  }
  [[noreturn]] void Refuse(const std::string& wanted) const {
    throw UsageError("--set " + key_ + ": expected " + wanted + ", not '" + text_ + "'");
  }

  std::string key_, text_;
  bool found_ = false;
};

/// "left:=right" or "left=right".
std::pair<std::string, std::string> Split(const std::string& text, const std::string& separator,
                                          const std::string& option) {
  const size_t at = text.find(separator);
  if (at == std::string::npos || at == 0 || at + separator.size() == text.size()) {
    throw UsageError(option + " '" + text + "': expected NAME" + separator + "VALUE");
  }
  return {text.substr(0, at), text.substr(at + separator.size())};
}

/// Effects, and their parameters' full names.
std::vector<std::string> EffectAndParameterNames() {
  const Vehicle vehicle = NominalVehicle();
  const std::vector<std::string>& effects = EffectRegistry::Default().names();
  std::vector<std::string> names = effects;
  for (const std::string& name : effects) {
    const std::unique_ptr<Effect> effect = EffectRegistry::Default().Make(name, vehicle);
    for (const ParameterSpec& spec : effect->parameters()) names.push_back(name + "." + spec.name);
  }
  return names;
}

fs::path ExecutableFolder() {
  std::error_code ignored;
  return fs::read_symlink("/proc/self/exe", ignored).parent_path();
}

/// Where the package keeps a script: installed beside or near the tool, or in the source tree.
std::string FindScript(const std::string& name) {
  std::error_code ignored;
  const fs::path folder = ExecutableFolder();
  for (const fs::path& path : {folder / name, folder / "../../share/odmc/scripts" / name,
                               fs::path(ODMC_SOURCE_DIR) / "scripts" / name}) {
    if (fs::is_regular_file(path, ignored)) return path.string();
  }
  return "";
}

/// A day between two poses is no flight: the clock was set, or files were joined.
void RefuseLeaps(const FlightLog& log, const std::string& file) {
  constexpr Stamp kDay = 86400 * static_cast<Stamp>(1000000000);
  for (size_t i = 1; i < log.odometry.size(); ++i) {
    const Stamp before = log.odometry[i - 1].stamp, step = log.odometry[i].stamp - before;
    if (step <= kDay) continue;
    const double at_s = ToSeconds(before - log.odometry.front().stamp);
    char text[160];
    std::snprintf(text, sizeof text,
                  ": time leaps by %.0f s, %.3f s after the first pose: the clock was set or "
                  "recordings were joined; --start and --end cut the flight out",
                  ToSeconds(step), at_s);
    throw std::invalid_argument(file + text);
  }
}

CLI::Validator NumberThat(bool may_be_zero) {
  const auto check = [may_be_zero](const std::string& text) -> std::string {
    double number = 0.0;
    const bool sound = ParseNumber(text, &number) && std::isfinite(number) &&
                       (number > 0.0 || (may_be_zero && number == 0.0));
    if (sound) return "";
    return "expected a number " + std::string(may_be_zero ? "of zero or more" : "above zero") +
           ", not '" + text + "'";
  };
  return CLI::Validator(check, may_be_zero ? "NONNEGATIVE" : "POSITIVE");
}

/// An option that takes which entry of a message is which rotor.
void AddOrder(const std::string& name, const std::string& what, std::vector<int>* order,
              CLI::App* app) {
  const auto take = [name, order](const std::string& text) {
    try {
      *order = ParseOrder(text);
    } catch (const std::invalid_argument& e) {
      throw UsageError(name + ": " + e.what());
    }
  };
  app->add_option_function<std::string>(
         name, take, "which entry of the message, from 1, is " + what + ", as 2,4,1,3")
      ->type_name("i,j,..");
}

}  // namespace

void AddOrders(CLI::App* app, StreamOptions* options) {
  AddOrder("--rotor-order", "rotor 1, 2, ... of the vehicle file", &options->rotor_order, app);
  AddOrder("--command-order", "the command of rotor 1, 2, ...", &options->command_order, app);
}

CLI::Validator Positive() { return NumberThat(false); }
CLI::Validator NotNegative() { return NumberThat(true); }

int Run(CLI::App* app, int argc, char** argv, const std::function<void()>& tool) {
  try {
    app->parse(argc, argv);
    tool();
    return 0;
  } catch (const CLI::ParseError& e) {
    if (e.get_exit_code() == 0) return app->exit(e);  // --help
    return Fail(std::string(e.what()) + " (--help explains all)", 2);
  } catch (const UsageError& e) {
    return Fail(std::string(e.what()) + " (--help explains all)", 2);
  } catch (const std::bad_alloc&) {
    return Fail("out of memory", 1);
  } catch (const std::exception& e) {
    return Fail(e.what(), 1);
  }
}

ProgressBar::ProgressBar(std::string label)
    : label_(std::move(label)), on_terminal_(isatty(STDERR_FILENO) != 0) {}

ProgressBar::~ProgressBar() {
  if (on_terminal_ && percent_ >= 0 && percent_ < 100) std::cerr << "\r\033[K" << std::flush;
}

void ProgressBar::Show(double share) {
  constexpr int kWidth = 40;
  const int percent = static_cast<int>(100.0 * std::clamp(share, 0.0, 1.0));
  if (!on_terminal_ || percent == percent_) return;
  percent_ = percent;
  if (percent == 100) {
    std::cerr << "\r\033[K" << std::flush;
    return;
  }
  const int done = kWidth * percent / 100;
  std::cerr << "\r" << label_ << " [" << std::string(done, '#') << std::string(kWidth - done, '.')
            << "] " << percent << " %" << std::flush;
}

std::function<void(double)> ProgressBar::Callback() {
  return [this](double share) { Show(share); };
}

namespace {

void AddFlight(std::string* file, bool required, CLI::App* app) {
  app->add_option("FLIGHT", *file,
                  "recorded flight: a rosbag (.bag), a CSV file (.csv), an autopilot's log (" +
                      std::string(kLogEndings) + "), or one of NeuroBEM or Blackbird as published")
      ->required(required);
}

}  // namespace

void FlightArguments::AddTo(CLI::App* app, bool required) {
  AddFlight(&file, required, app);
  AddOptionsTo(app);
  AddActuatorTo(app);
}

void FlightArguments::AddOptionTo(CLI::App* app, const std::string& option) {
  app->add_option(option, file, "recorded flight of any format")->type_name("FLIGHT");
  AddOptionsTo(app);
  AddActuatorTo(app);
}

std::string FlightArguments::FormatEnding() const {
  const FlightReaders readers = AllFlightReaders(bag);
  const FlightReader* reader = readers.Find(file);
  return reader == nullptr ? "" : reader->endings.front();
}

void FlightArguments::AddReadingTo(CLI::App* app) {
  AddFlight(&file, true, app);
  AddOptionsTo(app);
}

void FlightArguments::AddSeveralTo(CLI::App* app) {
  app->add_option("FLIGHT", several,
                  "recorded flights: rosbags (.bag), CSV files (.csv), autopilots' logs (" +
                      std::string(kLogEndings) +
                      "), folders of them, patterns ('day1/*.bag'); a list of them as @FILE, one a "
                      "line")
      ->required();
  AddOptionsTo(app);
  AddActuatorTo(app);
}

namespace {

/// Numbers in names by their size.
bool NaturallyBefore(const std::string& a, const std::string& b) {
  const auto is_digit = [](char c) { return c >= '0' && c <= '9'; };
  size_t i = 0, j = 0;
  while (i < a.size() && j < b.size()) {
    if (is_digit(a[i]) && is_digit(b[j])) {
      const auto skip = [&](const std::string& text, size_t at) {
        while (at < text.size() && text[at] == '0') ++at;
        return at;
      };
      const size_t i0 = skip(a, i), j0 = skip(b, j);
      for (i = i0; i < a.size() && is_digit(a[i]);) ++i;
      for (j = j0; j < b.size() && is_digit(b[j]);) ++j;
      if (i - i0 != j - j0) return i - i0 < j - j0;
      const int order = a.compare(i0, i - i0, b, j0, j - j0);
      if (order != 0) return order < 0;
    } else {
      if (a[i] != b[j]) return a[i] < b[j];
      ++i;
      ++j;
    }
  }
  return a.size() - i < b.size() - j;
}

void AddFlights(const std::string& name, std::set<std::string>* seen,
                std::vector<std::string>* files) {
  const FlightReaders readers = AllFlightReaders({});
  std::vector<std::string> found;
  if (readers.IsFlightFolder(name)) {
    found.push_back(name);
  } else if (fs::is_directory(name)) {
    for (fs::recursive_directory_iterator it(name), end; it != end; ++it) {
      const bool is_flight =
          it->is_directory() ? readers.IsFlightFolder(it->path()) : readers.IsFlight(it->path());
      if (is_flight) found.push_back(it->path());
      if (is_flight && it->is_directory()) it.disable_recursion_pending();
    }
  } else if (fs::exists(name)) {
    found.push_back(name);
  } else if (name.find_first_of("*?[") != std::string::npos) {
    glob_t matches;
    if (glob(name.c_str(), 0, nullptr, &matches) == 0) {
      for (size_t i = 0; i < matches.gl_pathc; ++i) {
        if (readers.IsFlight(matches.gl_pathv[i])) found.push_back(matches.gl_pathv[i]);
      }
    }
    globfree(&matches);
  }
  const bool is_named_as_one =
      readers.HasEnding(name) || fs::path(name).extension().string() == ".json";
  if (found.empty() && is_named_as_one && !fs::is_directory(name)) {
    found.push_back(name);  // the reader says what is wrong with it
  }
  if (found.empty()) {
    throw std::invalid_argument(name + (fs::is_directory(name)
                                            ? ": holds no flight (" + readers.Names() + ")"
                                            : ": no such file, folder or pattern of flights"));
  }
  std::sort(found.begin(), found.end(), NaturallyBefore);
  for (std::string& file : found) {
    if (seen->insert(file).second) files->push_back(std::move(file));
  }
}

}  // namespace

std::vector<std::string> FlightArguments::Expand() const { return FlightsNamed(several); }

std::vector<std::string> FlightsNamed(const std::vector<std::string>& names) {
  std::vector<std::string> files;
  std::set<std::string> seen;
  for (const std::string& name : names) {
    if (name.size() < 2 || name[0] != '@') {
      AddFlights(name, &seen, &files);
      continue;
    }
    std::ifstream list(name.substr(1));
    if (!list) throw std::invalid_argument(name.substr(1) + ": cannot be read");
    for (std::string line; std::getline(list, line);) {
      if (!line.empty()) AddFlights(line, &seen, &files);
    }
  }
  return files;
}

void FlightArguments::AddOptionsTo(CLI::App* app) {
  app->add_option("--start", start_s, "leave out what comes before this time [s]")
      ->check(NotNegative());
  app->add_option("--end", end_s,
                  "leave out what comes after this time since the recording's start [s]")
      ->check(Positive());
  const std::map<std::string, PoseSource> poses = {{"ekf", PoseSource::kEkf},
                                                   {"mocap", PoseSource::kMocap}};
  app->add_option("--pose", pose,
                  "ekf: the recording's odometry; mocap: NAME_mocap.csv beside the CSV, or the "
                  "bag's pose topic")
      ->transform(CLI::CheckedTransformer(poses).description(""))
      ->type_name("ekf|mocap");
  AddOdometryTo(app);
  app->add_option(
         "--topic", topics,
         "topic of a bag by role, as odometry:=/vio/odom; roles: odometry, pose, imu, "
         "rotor_speeds, joint_states, battery_state, motor_commands, twist, tf, tf_static; "
         "may be given several times")
      ->allow_extra_args(false)
      ->type_name("NAME:=/topic");
  app->add_option("--twist-frame", bag.twist_frame,
                  "frame of the bag's linear twist; auto finds it from d(position)/dt")
      ->check(CLI::IsMember({"auto", "body", "world"}).description(""))
      ->type_name("auto|body|world")
      ->capture_default_str();
  app->add_option("--odometry-tf-parent", bag.odometry_tf_parent,
                  "take the odometry from the bag's tf: frame of the world")
      ->type_name("FRAME");
  app->add_option("--odometry-tf-child", bag.odometry_tf_child,
                  "the same: frame of the body, or of the sensor that the vehicle file mounts")
      ->type_name("FRAME");
  app->add_option("--rotor-speed-unit", bag.rotor_speed_unit,
                  "unit of a bag's rotor speeds; auto: as the type of the message says, rad_s for "
                  "joint_states")
      ->check(CLI::IsMember({"auto", "rad_s", "rpm", "erpm"}).description(""))
      ->type_name("auto|rad_s|rpm|erpm")
      ->capture_default_str();
  app->add_option("--pole-pairs", pole_pairs, "of the motors, for erpm [7, or what a log says]")
      ->check(Positive());
  AddFieldsTo(app);
}

void FlightArguments::AddOdometryTo(CLI::App* app) {
  app->add_option(
         "--odometry", odometry,
         "recording of the flight's poses by another clock (motion capture, VIO), for logs "
         "that have none; the clocks' offset is found by the gyro. A folder: its file of "
         "the flight's name")
      ->check(CLI::ExistingPath.description(""))
      ->type_name("FILE");
  app->add_option("--odometry-offset", odometry_offset_s,
                  "to be added to the stamps of --odometry, in place of finding it [s]")
      ->check(CLI::Number.description(""))
      ->type_name("S");
  app->add_flag(
      "--accelerometer", accelerometer,
      "NeuroBEM: take the columns acc as an accelerometer, where they are specific force; "
      "the data set does not say whether they were measured");
  app->add_option("--max-spread", rotor_spread_s,
                  "Blackbird: largest difference of the stamps in a message of rotor speeds [s]")
      ->check(NotNegative())
      ->capture_default_str();
}

void FlightArguments::AddActuatorTo(CLI::App* app) {
  const std::map<std::string, bool> sources = {{"sensor", false}, {"commands", true}};
  app->add_option("--rotor-speed-from", from_commands,
                  "sensor, or commands: from the ESCs' commands and the battery voltage by the "
                  "vehicle's actuator [sensor]")
      ->transform(CLI::CheckedTransformer(sources).description(""))
      ->type_name("sensor|commands");
  app->add_option("--actuator", actuator_file,
                  "actuator.yaml of calibrate_actuator, in place of the vehicle file's")
      ->check(CLI::ExistingFile);
}

void FlightArguments::AddFieldsTo(CLI::App* app) {
  app->add_option("--rotor-topic-field", bag.rotor_topic_field,
                  "where the rotor speeds are in messages of the topic rotor_speeds, as "
                  "esc_status[].rpm; types that are known need none")
      ->type_name("PATH");
  app->add_option("--rotor-stamp-field", bag.rotor_stamp_field,
                  "where the stamps of the rotor speeds are, one per rotor or one for all, as "
                  "esc_status[].timestamp [header.stamp]")
      ->type_name("PATH");
  app->add_option("--rotor-stamp-unit", bag.rotor_stamp_unit,
                  "unit of these stamps where they are numbers; auto: they are times of ROS")
      ->check(CLI::IsMember({"auto", "s", "ms", "us", "ns"}).description(""))
      ->type_name("auto|s|ms|us|ns")
      ->capture_default_str();
  AddOrders(app, &bag);
  app->add_option("--command-topic-field", bag.command_topic_field,
                  "the same for commands, as channels[]")
      ->type_name("PATH");
  app->add_option(
         "--command-unit", bag.command_unit,
         "unit of commands: us (1000 to 2000), raw16 (0 to 65535), fraction (0 to 1); auto: "
         "as the type of the message says")
      ->check(CLI::IsMember({"auto", "fraction", "us", "raw16"}).description(""))
      ->type_name("auto|fraction|us|raw16")
      ->capture_default_str();
  app->add_option("--battery-topic-field", bag.battery_topic_field,
                  "the same for the battery voltage [V], as esc_status[0].voltage")
      ->type_name("PATH");
}

namespace {

bool IsBag(const FlightReaders& readers, const std::string& file) {
  const FlightReader* reader = file.empty() ? nullptr : readers.Find(file);
  return reader != nullptr && !reader->endings.empty() && reader->endings.front() == ".bag";
}

}  // namespace

void FlightArguments::CheckOptions(const FlightReaders& readers, const std::string& flight,
                                   const std::string& poses) const {
  if (odometry_offset_s && odometry.empty()) {
    throw UsageError("--odometry-offset goes with --odometry FILE");
  }
  const FlightReader* reader = readers.Find(flight);
  if (reader == nullptr) return;
  if (accelerometer && reader->name.find("NeuroBEM") == std::string::npos) {
    throw UsageError("--accelerometer is for NeuroBEM's CSV files; " + flight + " is " +
                     reader->name);
  }
  const bool is_bag = IsBag(readers, flight);
  const BagOptions defaults;
  const auto refuse = [&](const std::string& option) {
    const bool is_csv = !reader->endings.empty() && reader->endings.front() == ".csv";
    throw UsageError(option + " is for bags: " +
                     (is_csv ? "columns of a CSV file have their units and frames (rotor speeds in "
                               "rad/s, velocity in the world frame)"
                             : "an autopilot's log has its units and frames"));
  };
  if (!is_bag && !IsBag(readers, poses)) {
    if (!topics.empty()) refuse("--topic");
    if (bag.twist_frame != defaults.twist_frame) refuse("--twist-frame");
    if (!bag.odometry_tf_parent.empty()) refuse("--odometry-tf-parent");
    if (!bag.odometry_tf_child.empty()) refuse("--odometry-tf-child");
  }
  if (is_bag) return;
  if (bag.rotor_speed_unit != defaults.rotor_speed_unit) refuse("--rotor-speed-unit");
  if (!bag.rotor_topic_field.empty()) refuse("--rotor-topic-field");
  if (!bag.rotor_stamp_field.empty()) refuse("--rotor-stamp-field");
  if (!bag.rotor_order.empty()) refuse("--rotor-order");
  if (!bag.command_topic_field.empty()) refuse("--command-topic-field");
  if (bag.command_unit != defaults.command_unit) refuse("--command-unit");
  if (!bag.command_order.empty()) refuse("--command-order");
  if (!bag.battery_topic_field.empty()) refuse("--battery-topic-field");
}

std::string FlightArguments::OdometryOf(const std::string& flight,
                                        const FlightReaders& readers) const {
  if (odometry.empty() || !fs::is_directory(odometry) || readers.IsFlightFolder(odometry)) {
    return odometry;
  }
  const std::string name = fs::path(flight).stem().string();
  std::vector<std::string> found;
  for (const auto& entry : fs::directory_iterator(odometry)) {
    if (entry.path().stem().string() == name && readers.HasEnding(entry.path().string())) {
      found.push_back(entry.path().string());
    }
  }
  if (found.size() != 1) {
    throw std::invalid_argument(odometry + ": has " + (found.empty() ? "no" : "more than one") +
                                " recording of the name of " + flight);
  }
  return found.front();
}

FlightLog FlightArguments::ReadAsRecorded(const std::string& flight, int num_rotors,
                                          FlightPart part) const {
  if (end_s > 0.0 && end_s <= start_s) throw UsageError("--end must lie after --start");
  BagOptions options = bag;
  std::vector<std::string> roles;
  for (const StreamRole& role : StreamRoles()) roles.emplace_back(role.name);
  for (const std::string& text : topics) {
    const auto [role, topic] = Split(text, ":=", "--topic");
    if (std::find(roles.begin(), roles.end(), role) == roles.end()) {
      throw UsageError("--topic " + text + ": there is no role '" + role + "'");
    }
    options.topics[role] = topic;
  }
  if (pole_pairs) options.pole_pairs = *pole_pairs;
  const FlightReaders readers = AllFlightReaders(options);
  const std::string poses = OdometryOf(flight, readers);
  CheckOptions(readers, flight, poses);
  FlightReadOptions read;
  read.num_rotors = num_rotors;
  read.pose = pose;
  read.pole_pairs = pole_pairs;
  read.part = part;
  read.accelerometer = accelerometer;
  read.rotor_spread_s = rotor_spread_s;
  if (poses.empty()) return readers.Read(flight, read);
  FlightReadOptions read_poses = read;
  read_poses.part = FlightPart::kPoses;
  read_poses.accelerometer = false;
  read.part = FlightPart::kOnboard;
  read.pose = PoseSource::kEkf;
  FlightLog log = readers.Read(flight, read);
  JoinOdometry(readers.Read(poses, read_poses), odometry_offset_s, &log);
  return log;
}

FlightLog FlightArguments::Read(const std::string& flight, const Vehicle& vehicle) const {
  FlightLog log = ReadAsRecorded(flight, vehicle.num_rotors());
  const std::string unit = ImpossibleRotorUnit(log, vehicle);
  if (!unit.empty()) throw std::invalid_argument(flight + ": " + unit);
  MendFlight(&log);
  if (log.rotors.empty() && !log.commands.empty() && !from_commands) {
    throw std::invalid_argument(flight +
                                ": no rotor speeds; it has commands: try "
                                "--rotor-speed-from commands");
  }
  CutFlight(start_s, end_s, &log);
  RefuseLeaps(log, flight);
  const std::optional<Actuator> actuator =
      actuator_file.empty() ? vehicle.actuator : LoadActuator(actuator_file);
  SettleRotors(actuator, vehicle.num_rotors(), from_commands, &log);
  if (log.odometry.size() < 2 || log.rotors.empty()) {
    const bool cut = start_s > 0.0 || end_s > 0.0;
    throw std::invalid_argument(flight + ": no flight: " + std::to_string(log.odometry.size()) +
                                " poses and " + std::to_string(log.rotors.size()) +
                                " readings of rotor speeds" +
                                (cut ? " between --start and --end" : ""));
  }
  return log;
}

StreamInspection InspectFlight(const Vehicle& vehicle, bool force, FlightLog* log) {
  return InspectOrRefuse(vehicle, force, "--force", log);
}

void AddForce(CLI::App* app, bool* force) {
  app->add_flag("--force", *force,
                "go on where the recording or the vehicle file is wrong beyond learning; the "
                "result is not to be trusted");
}

void ModelArguments::AddTo(CLI::App* app) {
  const CLI::Validator effect = CLI::IsMember(EffectRegistry::Default().names()).description("");
  const CLI::Validator parameter = CLI::IsMember(EffectAndParameterNames()).description("");
  auto* effects = app->add_option("--effects", choice.effects,
                                  "the model's effects, replaces the files' list; list_effects "
                                  "shows all")
                      ->delimiter(',')
                      ->allow_extra_args(false)
                      ->check(effect)
                      ->type_name("a,b");
  app->add_option("--without", choice.without, "effects to leave out of the files' list")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->check(effect)
      ->type_name("a,b")
      ->excludes(effects);
  app->add_option("--free", choice.free, "estimate these: full names (thrust.k_f) or effects")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->check(parameter)
      ->type_name("a,b");
  app->add_option("--freeze", choice.freeze, "hold these: full names (rotor_torque.k_m) or effects")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->check(parameter)
      ->type_name("a,b");
}

void ModelArguments::AddParametersTo(CLI::App* app, const std::string& help) {
  app->add_option("--parameters", parameters_file, help)->type_name("FILE");
}

Vehicle ModelArguments::Configure(const Vehicle& file_vehicle) {
  if (parameters_file.empty()) return odmc::Configure(file_vehicle, choice);
  choice.parameters = LoadParameters(parameters_file);
  try {
    return odmc::Configure(file_vehicle, choice);
  } catch (const std::invalid_argument& e) {
    throw std::invalid_argument(parameters_file + ": " + e.what());
  }
}

void EstimatorArguments::AddTo(CLI::App* app, bool with_window) {
  app->add_option("--config", config_file, "estimator options, YAML")->type_name("FILE");
  app->add_option("--keyframe-rate", keyframe_rate_hz, "at most this many keyframes a second [Hz]")
      ->check(Positive());
  if (with_window) {
    app->add_option("--window", window_s, "length of the sliding window [s]")->check(Positive());
  }
  app->add_option("--threads", threads, "threads that evaluate factors")->check(Positive());
  app->add_option("--set", settings,
                  "any option of the estimator, see below; may be given several "
                  "times")
      ->allow_extra_args(false)
      ->type_name("KEY=VALUE");
  app->footer("Estimator options (--config FILE or --set KEY=VALUE) with their defaults:\n" +
              FormatOptions(defaults) + "\n" + kExitStatus);
}

EstimatorOptions OfflineOptions() {
  EstimatorOptions options;
  options.max_update_time_s = 1.0;
  return options;
}

EstimatorOptions AttributionEstimatorOptions() {
  EstimatorOptions options = OfflineOptions();
  options.keyframe_rate_hz = 50.0;
  return options;
}

EstimatorOptions EstimatorArguments::Read() const {
  EstimatorOptions options = defaults;
  if (!config_file.empty()) LoadOptions(config_file, &options);
  if (keyframe_rate_hz > 0.0) options.keyframe_rate_hz = keyframe_rate_hz;
  if (window_s > 0.0) options.window_s = window_s;
  if (threads > 0) options.num_threads = threads;
  for (const std::string& text : settings) {
    const auto [key, value] = Split(text, "=", "--set");
    OptionSetter setter(key, value);
    options.Visit(&setter);
    if (!setter.found()) throw UsageError("--set " + text + ": there is no option '" + key + "'");
  }
  std::string error;
  if (!options.IsValid(&error)) throw UsageError(error);
  return options;
}

std::string DescribeChanges(const EstimatorOptions& options) {
  std::istringstream now(FormatOptions(options)), before(FormatOptions(OfflineOptions()));
  std::string line, default_line, text;
  while (std::getline(now, line) && std::getline(before, default_line)) {
    if (line != default_line) text += (text.empty() ? "" : ", ") + line;
  }
  return text.empty() ? "defaults" : text;
}

void AddVehicle(CLI::App* app, std::string* file) {
  app->add_option("--vehicle", *file, "vehicle description, YAML")->required()->type_name("FILE");
}

void AddDefaultVehicle(CLI::App* app, std::string* file) {
  for (const fs::path& share :
       {fs::path(ODMC_SOURCE_DIR), ExecutableFolder() / "../../share/odmc"}) {
    *file = (share / "config/vehicles/generic.yaml").string();
    std::error_code ignored;
    if (fs::is_regular_file(*file, ignored)) break;
  }
  app->add_option("--vehicle", *file, "vehicle description, YAML [the generic one]")
      ->type_name("FILE");
}

void AddTrajectory(CLI::App* app, SimulationOptions* options) {
  const auto check = [](const std::string& name) {
    std::string error;
    TrajectoryOptions flown;
    flown.name = name;
    return flown.IsValid(&error) ? "" : error;
  };
  app->add_option("--trajectory", options->trajectory,
                  CLI::detail::join(Trajectory::Names(), ", ") + ", or a waypoint file (*.yaml)")
      ->required()
      ->check(CLI::Validator(check, ""))
      ->type_name("NAME|FILE");
  app->add_option("--duration", options->duration_s, "of a whole flight [s]")
      ->capture_default_str()
      ->check(Positive());
}

void AddExitStatus(CLI::App* app) { app->footer(kExitStatus); }

void AddFolder(CLI::App* app, std::string* folder, bool* no_report) {
  app->add_option("--out", *folder, "folder for the results; made where missing, files overwritten")
      ->required()
      ->type_name("DIR");
  if (no_report != nullptr) app->add_flag("--no-report", *no_report, "do not draw report.html");
}

void MakeFolder(const std::string& folder) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (!fs::is_directory(folder)) throw std::runtime_error(folder + ": cannot be made a folder");
}

std::string In(const std::string& folder, const std::string& name) {
  return (fs::path(folder) / name).string();
}

void WriteCalibration(const Calibration& calibration, const FlightLog& log,
                      const DynamicModel& model, const std::string& folder) {
  SaveParameters(calibration.parameters, In(folder, "parameters.yaml"));
  WriteHistory(calibration, log, model, In(folder, "history.csv"));
  WriteTiming(calibration, In(folder, "timing.csv"));
  WritePhases(calibration, In(folder, "phases.csv"));
  WriteText(CalibrationReport(calibration, model), In(folder, "report.json"));
}

std::map<std::string, std::string> Provenance(const std::string& tool, const Vehicle& vehicle,
                                              std::map<std::string, std::string> more) {
  more["tool"] = tool;
  more["version"] = ODMC_VERSION;
  more["vehicle"] = vehicle.name;
  more["mass_kg"] = FormatNumber(vehicle.mass_kg);
  return more;
}

void RenderReport(const std::string& folder, const std::string& script_name) {
  const auto warn = [&](const std::string& why) {
    std::cerr << "warning: the pictures of " << Printable(folder) << " were not drawn: " << why
              << "\n";
  };
  const std::string script = FindScript(script_name);
  if (script.empty()) return warn(script_name + " is not installed");
  std::cout << std::flush;
  const pid_t child = fork();
  if (child < 0) return warn("no process to be had");
  if (child == 0) {
    execl(kPython, kPython, script.c_str(), folder.c_str(), static_cast<char*>(nullptr));
    _exit(127);
  }
  int status = 0;
  while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  if (!WIFEXITED(status) || WEXITSTATUS(status) != 0) warn(script + " failed");
}

Vehicle NominalVehicle() {
  constexpr double kX = 0.095, kY = 0.11, kRadius = 0.0635;
  Vehicle vehicle;
  vehicle.name = "nominal";
  vehicle.mass_kg = 0.75;
  vehicle.inertia_kg_m2 = {2.5e-3, 2.1e-3, 4.3e-3};
  vehicle.rotors = {{{kX, -kY, 0.0}, 1.0, kRadius},
                    {{kX, kY, 0.0}, -1.0, kRadius},
                    {{-kX, kY, 0.0}, 1.0, kRadius},
                    {{-kX, -kY, 0.0}, -1.0, kRadius}};
  vehicle.effects = DefaultEffects();
  return vehicle;
}

SimulationNoise ReadNoise(const std::string& name) {
  if (name == "none") return SimulationNoise::None();
  SimulationNoise noise;
  if (name != "default") LoadOptions(name, &noise);
  return noise;
}

}  // namespace odmc::tools
