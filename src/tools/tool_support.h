#pragma once

#include <CLI/CLI.hpp>
#include <functional>
#include <map>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "odmc/analysis/calibration.h"
#include "odmc/analysis/model_choice.h"
#include "odmc/estimator/options.h"
#include "odmc/ros/flight_bag.h"
#include "odmc/sim/simulator.h"

namespace odmc::tools {

/// A command line that makes no sense: exit status 2.
class UsageError : public std::invalid_argument {
 public:
  using std::invalid_argument::invalid_argument;
};

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

/// FLIGHT and how to read it.
struct FlightArguments {
  std::string file;
  std::vector<std::string> several;  ///< where AddSeveralTo() was called
  double start_s = 0.0, end_s = 0.0;
  PoseSource pose = PoseSource::kEkf;
  std::vector<std::string> topics;
  BagOptions bag;
  std::optional<int> pole_pairs;
  std::string odometry;  ///< recording with the poses, or folder of such; empty: FLIGHT has them
  std::optional<double> odometry_offset_s;
  bool accelerometer = false;
  double rotor_spread_s = FlightReadOptions().rotor_spread_s;
  std::string actuator_file;
  bool from_commands = false;

  /// Adds FLIGHT, --start, --end, --pose, --odometry, --topic, --twist-frame, --rotor-speed-unit,
  /// --pole-pairs, fields, units and orders of a bag's messages, --rotor-speed-from, --actuator.
  /// @param required false where the tool can do without a flight
  void AddTo(CLI::App* app, bool required = true);
  /// Adds FLIGHT and what says how a file is to be read: without --rotor-speed-from, --actuator.
  void AddReadingTo(CLI::App* app);
  /// The same as AddTo() with an option in the place of FLIGHT, which may be left out.
  void AddOptionTo(CLI::App* app, const std::string& option);
  /// The same as AddTo() with FLIGHT..., files, folders and patterns.
  void AddSeveralTo(CLI::App* app);
  /// The flights these name, each once: of a folder every flight in it and below, in natural order
  /// (flight2 before flight10).
  /// @throws std::invalid_argument naming what is no flight, or holds none
  std::vector<std::string> Expand() const;
  /// The flight with the rotor speeds to be used: rotors whose sensor is bad get the actuator
  /// model's, where there are commands.
  /// @throws std::invalid_argument, UsageError
  FlightLog Read(const Vehicle& vehicle) const { return Read(file, vehicle); }
  FlightLog Read(const std::string& flight, const Vehicle& vehicle) const;
  /// The ending of the flight's format, ".csv" or ".bfl"; empty where no format fits.
  std::string FormatEnding() const;
  /// The flight as it was recorded, whole.
  /// @throws std::invalid_argument, UsageError
  FlightLog ReadAsRecorded(const std::string& flight, int num_rotors,
                           FlightPart part = FlightPart::kWhole) const;

 private:
  void AddOptionsTo(CLI::App* app);
  void AddOdometryTo(CLI::App* app);
  /// Refuses options that do not belong to the format of the flight, nor to that of its poses.
  void CheckOptions(const FlightReaders& readers, const std::string& flight,
                    const std::string& poses) const;
  /// The recording of the flight's poses; empty where the flight has its own.
  std::string OdometryOf(const std::string& flight, const FlightReaders& readers) const;
  void AddFieldsTo(CLI::App* app);
  void AddActuatorTo(CLI::App* app);
};

/// The flights that names of files, folders and patterns stand for, as FlightArguments::Expand().
std::vector<std::string> FlightsNamed(const std::vector<std::string>& names);

/// Compares the recording's streams with each other and mends the log by what was found.
/// @param force goes on where nothing sensible can be learned
/// @throws std::invalid_argument naming the file, the cause and what would mend it
StreamInspection InspectFlight(const Vehicle& vehicle, bool force, FlightLog* log);

/// Adds --rotor-order and --command-order.
void AddOrders(CLI::App* app, StreamOptions* options);

/// Adds --force.
void AddForce(CLI::App* app, bool* force);

/// Which effects and parameters.
struct ModelArguments {
  ModelChoice choice;
  std::string parameters_file;

  /// Adds --effects, --without, --free, --freeze.
  void AddTo(CLI::App* app);
  /// Adds --parameters with this help text.
  void AddParametersTo(CLI::App* app, const std::string& help);
  /// The vehicle with all of it.
  Vehicle Configure(const Vehicle& file_vehicle);
};

/// The estimator's defaults for the tools: no solve is cut short by the clock, so that a flight
/// gives the same numbers on any machine, loaded or not.
EstimatorOptions OfflineOptions();

/// The same for attribution: keyframes at 50 Hz, which give the same verdicts and figures as 100 Hz
/// in two thirds of the time.
EstimatorOptions AttributionEstimatorOptions();

/// Options of the estimator.
struct EstimatorArguments {
  EstimatorOptions defaults = OfflineOptions();
  std::string config_file;
  double keyframe_rate_hz = 0.0, window_s = 0.0;
  int threads = 0;
  std::vector<std::string> settings;

  /// Adds --config, --keyframe-rate, --window, --threads, --set.
  /// @param with_window false where the tool itself sets the window
  void AddTo(CLI::App* app, bool with_window = true);
  EstimatorOptions Read() const;
};

/// Every option of the estimator that is not at its default, "key value, ..."; else "defaults".
std::string DescribeChanges(const EstimatorOptions& options);

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
