#pragma once

#include <functional>
#include <string>
#include <vector>

#include "odmc/analysis/calibration.h"
#include "odmc/fleet/joint_estimate.h"
#include "odmc/fleet/recurrent_residuals.h"
#include "odmc/phases/flight_phase.h"

namespace odmc {

/// How a flight is read: from its file to a log that is checked and mended, with what may be wrong.
struct InspectedFlight {
  FlightLog log;
  StreamInspection inspection;
};
using FlightSource = std::function<InspectedFlight(const std::string& file)>;

/// One flight of many.
struct FleetFlight {
  std::string file;
  std::string failure;  ///< why it could not be used, in words; empty: it was
  std::vector<std::string> warnings;
  FlightFactor factor;
  PredictionFigures own_fit;   ///< predicted with what the flight itself shows
  PredictionFigures left_out;  ///< and with what all others show; empty where there are none
  FlightResiduals residuals;   ///< of that prediction
  int passes = 0;              ///< of the estimator
  /// What of it is no flight; not among what flight.json holds.
  StampSpans not_flown;
  std::vector<PhaseSpan> phases;  ///< all of the recording, oldest first
};

/// Several flights of a vehicle, calibrated each and combined.
struct FleetCalibration {
  std::vector<FleetFlight> flights;  ///< in the order they were flown
  JointEstimate joint;               ///< of those used, see used()
  ParameterSet parameters;
  /// What flights left out have in common that the model does not explain, outliers not counted;
  /// empty where flights were not predicted. The least likely by chance first.
  std::vector<RecurrentResidual> recurrent;
  double false_alarm_rate = 0.0;  ///< below which a p-value counts

  /// Indices in `flights` of what the joint estimate's flights are.
  std::vector<int> used() const;
};

/// How several flights are calibrated.
struct JointCalibrationOptions {
  EstimatorOptions estimator = OfflineOptions();
  JointOptions joint;
  std::vector<std::string> own;  ///< full names or effects that are each flight's own, too
  int jobs = 1;
  /// A flight's pass is made anew, started at the joint estimate, where that is further from where
  /// it was linearized than this share of the vehicle file's prior sigma.
  double relinearize_share = 0.5;
  int most_passes = 2;
  /// Flights that tell what all share: errors of the streams, the step between keyframes.
  int doubted_flights = 3;
  bool predict_left_out = true;
};

/// What a fleet needs of a calibrated flight.
/// @param model with which it was calibrated
FleetFlight FleetFlightOf(const Calibration& calibration, const DynamicModel& model,
                          const std::vector<std::string>& own = {});

/// Calibrates one flight and takes its factor.
/// @param vehicle with the choice of model in it; `start`, where given: values to start from, the
///   vehicle's priors stay
FleetFlight CalibrateFlight(const std::string& file, const FlightSource& source,
                            const Vehicle& file_vehicle, const Vehicle& vehicle,
                            const JointCalibrationOptions& options,
                            const ParameterSet* start = nullptr);

/// Calibrates flights one by one (where `known` does not hold their factor), combines what they
/// say, makes those anew that it moves far, and predicts each with what all others show. A flight
/// that cannot be used is named and left out.
/// @param known flights calibrated before, by file
/// @throws std::invalid_argument if no flight can be used
FleetCalibration CalibrateFleet(const std::vector<std::string>& files, const FlightSource& source,
                                const Vehicle& file_vehicle, const Vehicle& vehicle,
                                const JointCalibrationOptions& options,
                                const std::vector<FleetFlight>& known = {},
                                const std::function<void(double)>& progress = {});

/// Predicts flights that had no part in a joint estimate, each with what that says of the vehicle
/// and with what the flight itself shows of what is its own (`left_out` of the results).
std::vector<FleetFlight> PredictHeldOut(const std::vector<std::string>& files,
                                        const FlightSource& source, const Vehicle& file_vehicle,
                                        const Vehicle& vehicle,
                                        const JointCalibrationOptions& options,
                                        const FleetCalibration& fleet,
                                        const std::function<void(double)>& progress = {});

/// The fleet in JSON, as report.json of several flights.
std::string FleetReport(const FleetCalibration& fleet, const DynamicModel& model);
/// The same as a table for people.
std::string FleetTable(const FleetCalibration& fleet);
/// Parameters over flights as CSV: one row per flight and shared parameter.
std::string FleetHistoryCsv(const FleetCalibration& fleet);

}  // namespace odmc
