#pragma once

#include <CLI/CLI.hpp>
#include <map>
#include <string>
#include <vector>

#include "odmc/analysis/calibration.h"
#include "odmc/analysis/model_choice.h"
#include "odmc/attribution/close_loop.h"
#include "odmc/estimator/options.h"

namespace odmc::tools {

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

/// OfflineOptions() for attribution: keyframes at 50 Hz, which give the same verdicts and figures
/// as 100 Hz in two thirds of the time.
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

/// Says in what calibrate finds on one flight where it comes from, and what it may be trusted for.
/// @param position_noise_m that was added to the poses, sigma per axis [m]
void StateOrigin(const Vehicle& vehicle, double position_noise_m, const EstimatorOptions& options,
                 Calibration* calibration);

/// Where the parameters of a closed loop come from.
/// @param more the flight, or their number
std::map<std::string, std::string> ProvenanceOf(const CloseLoopOptions& options,
                                                const Vehicle& vehicle,
                                                std::map<std::string, std::string> more);

}  // namespace odmc::tools
