#pragma once

#include <CLI/CLI.hpp>
#include <string>
#include <vector>

#include "odmc/analysis/model_choice.h"
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

}  // namespace odmc::tools
