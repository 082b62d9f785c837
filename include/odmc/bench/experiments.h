#pragma once

#include <functional>
#include <map>
#include <string>
#include <vector>

#include "odmc/bench/controlled_flight.h"

namespace odmc {

/// What to fly and how often.
struct ExperimentOptions {
  int seeds = 10;  ///< flights per variant, each with another vehicle, >= 1
  int first_seed = 1;
  int jobs = 1;                      ///< flights at a time, >= 1
  double duration_s = 40.0;          ///< of the path, >= 20
  double keyframe_rate_hz = 50.0;    ///< of the estimator
  double estimator_dies_at_s = 0.0;  ///< killed in every flight; 0: never
};

/// Figures of one variant: medians over the seeds, and how far they spread.
struct VariantFigures {
  Eigen::Vector3d rmse_m, max_m;  ///< medians
  Eigen::Vector3d spread_m;       ///< interquartile range of the RMSE
  int seeds = 0, crashes = 0;
  double recovery_s = -1.0;      ///< median; negative: does not apply
  double recovery_max_s = -1.0;  ///< largest over the seeds
  bool has_torque = false;
  Eigen::Vector3d torque_rmse_Nm = Eigen::Vector3d::Zero();  ///< of the estimate's prediction
  double first_accepted_s = 0.0;                             ///< median
  double control_ms_p99 = 0.0;                               ///< largest
  std::vector<std::string> crash_reports;
};

/// One experiment: its variants in order, with the first seed's flights for pictures.
struct Experiment {
  std::string name, description;
  std::vector<std::string> variants;
  std::map<std::string, VariantFigures> figures;    ///< by variant
  std::map<std::string, ControlledFlight> example;  ///< by the flight's variant, first seed
  double recovery_limit_s = 0.0;
};

/// octo, vshape, cog_shift, payload, wind, damaged_propeller.
const std::vector<std::string>& ExperimentNames();

/// The vehicle of `seed`: `vehicle` with true coefficients drawn about those of DefaultTruth(), of
/// which neither estimator nor controller knows.
ModelValues DrawTruth(const DynamicModel& model, int seed);

/// Flies every seed of every variant.
/// @throws std::invalid_argument for an unknown name or options that are not valid
Experiment RunExperiment(const std::string& name, const Vehicle& vehicle,
                         const ExperimentOptions& options,
                         const std::function<void(double)>& progress = {});

/// The figures as JSON (keys: the experiments' names) and as a table for people.
std::string ExperimentReport(const std::vector<Experiment>& experiments);
std::string ExperimentTable(const std::vector<Experiment>& experiments);

/// Samples of one flight: t_s, reference, position, error, for pictures.
std::string TrackingCsv(const ControlledFlight& flight);

}  // namespace odmc
