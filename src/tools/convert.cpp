#include <filesystem>
#include <iostream>
#include <map>

#include "flight_arguments.h"
#include "flights_named.h"
#include "odmc/analysis/replay.h"
#include "odmc/io/autopilot_log_writers.h"
#include "odmc/io/flight_csv.h"
#include "odmc/text/printable_text.h"
#include "tool_support.h"

namespace {

using namespace odmc;

/// Moves every stream so that the first pose is at `start_s` [s].
void StartAt(double start_s, FlightLog* log) {
  if (log->odometry.empty()) throw tools::UsageError("--start-time needs poses");
  const Stamp shift = FromSeconds(start_s) - log->odometry.front().stamp;
  const auto move = [shift](auto* samples) {
    for (auto& sample : *samples) sample.stamp += shift;
  };
  move(&log->odometry);
  move(&log->imu);
  move(&log->rotors);
  move(&log->battery);
  move(&log->commands);
}

/// Writers of flights by the file's ending.
using Writer = void (*)(const FlightLog& log, const std::string& file);
const std::map<std::string, Writer> kWriters = {{".bag", WriteFlightBag}, {".csv", WriteFlightCsv},
                                                {".ulg", WriteULog},      {".bin", WriteDataflash},
                                                {".bbl", WriteBlackbox},  {".bfl", WriteBlackbox}};

/// Streams by the names of --without.
void Drop(const std::vector<std::string>& names, FlightLog* log) {
  for (const std::string& name : names) {
    if (name == "poses") log->odometry.clear();
    if (name == "imu") log->imu.clear();
    if (name == "rotors") log->rotors.clear();
    if (name == "commands") log->commands.clear();
    if (name == "battery") log->battery.clear();
  }
}

/// Autopilots' logs can do without poses, our own forms cannot.
void CheckPoses(const FlightLog& log, const std::string& flight, const std::string& ending) {
  if (log.odometry.empty() && (ending == ".bag" || ending == ".csv")) {
    throw std::invalid_argument(flight +
                                ": no poses to convert; --odometry FILE takes them from "
                                "another recording");
  }
}

std::string Count(size_t count, const std::string& what) {
  return std::to_string(count) + " " + what;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app(
      "Converts a recorded flight of any format: pose, IMU, rotor speeds, commands and battery\n"
      "voltage with their stamps. To a rosbag (.bag) or a CSV file (.csv) in the package's frames\n"
      "and units; a CSV file has one row per pose (an IMU with other stamps is interpolated), a "
      "bag\n"
      "keeps all. Or as an autopilot would have logged it: PX4 (.ulg), ArduPilot (.bin), "
      "INDIflight\n"
      "or, without poses, Betaflight (.bbl).");
  tools::FlightArguments flight;
  std::string out;
  int num_rotors = 4;
  double start_time_s = 0.0;
  std::vector<std::string> without;
  bool list = false;
  flight.AddReadingTo(&app);
  app.add_option("OUT", out, "flight to write: .bag, .csv, .ulg, .bin, .bbl; overwritten");
  app.add_option("--rotors", num_rotors, "of the vehicle")
      ->check(CLI::Range(1, kMaxRotors))
      ->capture_default_str();
  const CLI::Option* has_start = app.add_option("--start-time", start_time_s,
                                                "time of the first pose in OUT [as in FLIGHT; s]")
                                     ->check(tools::NotNegative());
  app.add_option("--without", without,
                 "streams to leave out: poses, imu, rotors, commands, battery")
      ->delimiter(',')
      ->check(CLI::IsMember({"poses", "imu", "rotors", "commands", "battery"}).description(""))
      ->type_name("a,b");
  app.add_flag("--list", list, "print the flights of FLIGHT (a folder or pattern), one a line");
  tools::AddExitStatus(&app);
  return tools::Run(&app, argc, argv, [&] {
    if (list) {
      for (const std::string& name : tools::FlightsNamed({flight.file})) std::cout << name << "\n";
      return;
    }
    const std::filesystem::path path(out);
    const auto writer = kWriters.find(path.extension().string());
    if (writer == kWriters.end()) {
      throw tools::UsageError("OUT must end in .bag, .csv, .ulg, .bin or .bbl");
    }
    std::error_code ignored;
    if (std::filesystem::equivalent(flight.file, out, ignored)) {
      throw tools::UsageError("OUT is FLIGHT itself");
    }
    FlightLog log = flight.ReadAsRecorded(flight.file, num_rotors, FlightPart::kOnboard);
    CutFlight(flight.start_s, flight.end_s, &log);
    if (has_start->count() > 0) StartAt(start_time_s, &log);
    Drop(without, &log);
    CheckPoses(log, flight.file, writer->first);
    for (const std::string& warning : log.warnings) std::cerr << "warning: " << warning << "\n";
    if (path.has_parent_path()) tools::MakeFolder(path.parent_path().string());
    writer->second(log, out);
    std::cout << Printable(out) << ": " << Count(log.odometry.size(), "poses, ")
              << Count(log.imu.size(), "IMU samples, ")
              << Count(log.rotors.size(), "readings of rotor speeds, ")
              << Count(log.commands.size(), "commands, ") << Count(log.battery.size(), "voltages")
              << "\n";
  });
}
