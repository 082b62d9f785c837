#include <filesystem>
#include <iostream>

#include "odmc/analysis/replay.h"
#include "odmc/io/printable_text.h"
#include "tool_support.h"

namespace {

using namespace odmc;

/// Moves every stream so that the first pose is at `start_s` [s].
void StartAt(double start_s, FlightLog* log) {
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

void Write(const FlightLog& log, const std::string& file) {
  const std::filesystem::path path(file);
  if (path.has_parent_path()) tools::MakeFolder(path.parent_path().string());
  path.extension() == ".bag" ? WriteFlightBag(log, file) : WriteFlightCsv(log, file);
}

std::string Count(size_t count, const std::string& what) {
  return std::to_string(count) + " " + what;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app(
      "Converts a recorded flight of any format to a rosbag or a CSV file: pose, IMU, rotor "
      "speeds,\n"
      "commands and battery voltage with their stamps, in the package's frames and units.\n"
      "A CSV file has one row per pose: an IMU with other stamps is interpolated, a bag keeps "
      "all.");
  tools::FlightArguments flight;
  std::string out;
  int num_rotors = 4;
  double start_time_s = 0.0;
  bool list = false;
  flight.AddReadingTo(&app);
  app.add_option("OUT", out, "flight to write, .bag or .csv; overwritten");
  app.add_option("--rotors", num_rotors, "of the vehicle")
      ->check(CLI::Range(1, kMaxRotors))
      ->capture_default_str();
  const CLI::Option* has_start = app.add_option("--start-time", start_time_s,
                                                "time of the first pose in OUT [as in FLIGHT; s]")
                                     ->check(tools::NotNegative());
  app.add_flag("--list", list, "print the flights of FLIGHT (a folder or pattern), one a line");
  tools::AddExitStatus(&app);
  return tools::Run(&app, argc, argv, [&] {
    if (list) {
      for (const std::string& name : tools::FlightsNamed({flight.file})) std::cout << name << "\n";
      return;
    }
    const std::string ending = std::filesystem::path(out).extension().string();
    if (ending != ".bag" && ending != ".csv")
      throw tools::UsageError("OUT must end in .bag or .csv");
    std::error_code ignored;
    if (std::filesystem::equivalent(flight.file, out, ignored)) {
      throw tools::UsageError("OUT is FLIGHT itself");
    }
    FlightLog log = flight.ReadAsRecorded(flight.file, num_rotors);
    CutFlight(flight.start_s, flight.end_s, &log);
    if (log.odometry.empty()) throw std::invalid_argument(flight.file + ": no poses to convert");
    if (has_start->count() > 0) StartAt(start_time_s, &log);
    for (const std::string& warning : log.warnings) std::cerr << "warning: " << warning << "\n";
    Write(log, out);
    std::cout << Printable(out) << ": " << Count(log.odometry.size(), "poses, ")
              << Count(log.imu.size(), "IMU samples, ")
              << Count(log.rotors.size(), "readings of rotor speeds, ")
              << Count(log.commands.size(), "commands, ") << Count(log.battery.size(), "voltages")
              << "\n";
  });
}
