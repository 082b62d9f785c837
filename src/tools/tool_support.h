#pragma once

#include <CLI/CLI.hpp>
#include <functional>
#include <map>
#include <stdexcept>
#include <string>
#include <utility>

#include "odmc/analysis/calibration.h"
#include "odmc/sim/simulator.h"

namespace odmc::tools {

/// A command line that makes no sense: exit status 2.
class UsageError : public std::invalid_argument {
 public:
  using std::invalid_argument::invalid_argument;
};

constexpr char kExitStatus[] = "Exit status: 0 success, 1 bad input, 2 usage.";

/// Parses the command line, runs the tool, and turns what it throws into one sentence on stderr.
/// @returns exit status: 0 success, 1 bad input, 2 usage
int Run(CLI::App* app, int argc, char** argv, const std::function<void()>& tool);

/// Shows the share done on stderr, on a terminal only; clears its line when all is done.
class ProgressBar {
 public:
  explicit ProgressBar(std::string label);
  ~ProgressBar();
  void Show(double share);
  /// Calls Show().
  std::function<void(double)> Callback();

 private:
  std::string label_;
  bool on_terminal_;
  int percent_ = -1;
};

/// Refuse what is no number above zero, or at least zero: infinity and NaN as well.
CLI::Validator Positive();
CLI::Validator NotNegative();

/// The two sides of "left:=right" or "left=right".
/// @throws UsageError naming the option where there are no two
std::pair<std::string, std::string> Split(const std::string& text, const std::string& separator,
                                          const std::string& option);

/// Adds the required --vehicle FILE.
void AddVehicle(CLI::App* app, std::string* file);
/// Adds --vehicle FILE, by default the generic vehicle of this package.
void AddDefaultVehicle(CLI::App* app, std::string* file);

/// Adds the required --trajectory NAME, and --duration.
void AddTrajectory(CLI::App* app, SimulationOptions* options);

/// Says what the exit status means at the end of --help.
void AddExitStatus(CLI::App* app);

/// Adds the required --out DIR; --no-report too if `no_report` is given.
void AddFolder(CLI::App* app, std::string* folder, bool* no_report = nullptr);

/// Adds --jobs.
void AddJobs(CLI::App* app, int* jobs);

/// Makes a folder with its parents where missing.
void MakeFolder(const std::string& folder);

/// A file in `folder`.
std::string In(const std::string& folder, const std::string& name);

/// Writes everything calibrate leaves in its folder but report.html.
void WriteCalibration(const Calibration& calibration, const FlightLog& log,
                      const DynamicModel& model, const std::string& folder);

/// Where a parameter set comes from: tool, version, vehicle, and more.
std::map<std::string, std::string> Provenance(const std::string& tool, const Vehicle& vehicle,
                                              std::map<std::string, std::string> more);

/// Runs a script of scripts/ on a folder; what goes wrong is a warning on stderr.
void RenderReport(const std::string& folder, const std::string& script_name = "render_report");

/// The vehicle of model.md section 8, where no file is given.
Vehicle NominalVehicle();

/// none, default, or a YAML file of SimulationNoise.
SimulationNoise ReadNoise(const std::string& name);

}  // namespace odmc::tools
