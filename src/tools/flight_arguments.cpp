#include "flight_arguments.h"

#include <algorithm>
#include <filesystem>
#include <map>
#include <stdexcept>
#include <utility>

#include "flights_named.h"
#include "odmc/analysis/report.h"
#include "odmc/identification/flight_actuator.h"
#include "odmc/inspection/join_odometry.h"
#include "odmc/inspection/recording_inspection.h"
#include "odmc/inspection/rotor_units.h"
#include "odmc/io/actuator_yaml.h"
#include "odmc/sensing/plausible.h"
#include "odmc/text/format.h"
#include "tool_support.h"

namespace odmc::tools {
namespace {

namespace fs = std::filesystem;

constexpr char kLogEndings[] = ".bfl, .bbl, .ulg, .bin";

/// A day between two poses is no flight: the clock was set, or files were joined.
void RefuseLeaps(const FlightLog& log, const std::string& file) {
  constexpr Stamp kDay = 86400 * static_cast<Stamp>(1000000000);
  for (size_t i = 1; i < log.odometry.size(); ++i) {
    const Stamp before = log.odometry[i - 1].stamp, step = log.odometry[i].stamp - before;
    if (step <= kDay) continue;
    const double at_s = ToSeconds(before - log.odometry.front().stamp);
    throw std::invalid_argument(
        file + Format(": time leaps by %.0f s, %.3f s after the first pose: the clock was set or "
                      "recordings were joined; --start and --end cut the flight out",
                      ToSeconds(step), at_s));
  }
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

void AddFlight(std::string* file, bool required, CLI::App* app) {
  app->add_option("FLIGHT", *file,
                  "recorded flight: a rosbag (.bag), a CSV file (.csv), an autopilot's log (" +
                      std::string(kLogEndings) + "), or one of NeuroBEM or Blackbird as published")
      ->required(required);
}

bool IsBag(const FlightReaders& readers, const std::string& file) {
  const FlightReader* reader = file.empty() ? nullptr : readers.Find(file);
  return reader != nullptr && !reader->endings.empty() && reader->endings.front() == ".bag";
}

}  // namespace

void AddOrders(CLI::App* app, StreamOptions* options) {
  AddOrder("--rotor-order", "rotor 1, 2, ... of the vehicle file", &options->rotor_order, app);
  AddOrder("--command-order", "the command of rotor 1, 2, ...", &options->command_order, app);
}

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

std::vector<std::string> FlightArguments::Expand() const { return FlightsNamed(several); }

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

void AddOwn(CLI::App* app, std::vector<std::string>* own) {
  app->add_option("--own", *own,
                  "parameters or effects that are each flight's own, beside gravity and wind: "
                  "odometry_extrinsics where the mount is taken off between flights")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->type_name("a,b");
}

void AddForce(CLI::App* app, bool* force) {
  app->add_flag("--force", *force,
                "go on where the recording or the vehicle file is wrong beyond learning; the "
                "result is not to be trusted");
}

}  // namespace odmc::tools
