#pragma once

#include <string>
#include <vector>

#include "odmc/fleet/random_effects.h"
#include "odmc/model/dynamic_model.h"

namespace odmc {

/// A parameter that steps at a flight and stays there, or drifts over all flights.
struct VehicleChange {
  /// At once, or by and by.
  enum class Kind { kStep, kTrend };
  Kind kind = Kind::kStep;
  int parameter = 0;  ///< index in the factors' names
  int from = 0;       ///< first flight of what is new; of a trend 0
  double size = 0.0;  ///< of the step; of a trend from the first flight to the last
  double sigma = 0.0;
  double p_value = 1.0;  ///< of all dates and parameters that it may have been
};

/// A flight on which a parameter was another one than on those around it.
struct OutlierFlight {
  int flight = 0;
  int parameter = 0;
  double by = 0.0, sigma = 0.0;  ///< away from what the others predict
  double p_value = 1.0;          ///< all flights and parameters accounted for
};

/// How flights are combined.
struct JointOptions {
  /// Share of histories without any in which a step, a trend or an outlier is seen all the same.
  double false_alarm_rate = 0.05;
  /// Full names of parameters that half of that rate is for: what people change between flights.
  std::vector<std::string> often_changed;
  /// Where each flight lies on the axis of a trend (dates [s]); empty: evenly.
  std::vector<double> times;
};

/// What all flights together say about the vehicle: as it is today, and what its next flight may
/// have.
struct JointEstimate {
  FleetModel model;
  RandomEffects fit;
  std::vector<VehicleChange> changes;
  std::vector<OutlierFlight> outliers;
  Eigen::VectorXd value;  ///< n×1, after the last change
  /// n×1: three of them hold the value as often as three of a normal variable's, however few
  /// flights show the scatter.
  Eigen::VectorXd sigma;
  Eigen::VectorXd new_flight_sigma;  ///< n×1, of a new flight's own value: scatter included
  Eigen::MatrixXd covariance;        ///< n×n, with `sigma`
};

/// Fits all flights together; finds flights and parameters that do not go with the rest, and
/// changes over time. Looks at one parameter after the other: what each flight says about it
/// (DeparturesOf), for and against a change, by a test that is the t test where scatter is all
/// (ExamineHistory); the least p-value of all dates and parameters counts (Bonferroni; weighted by
/// JointOptions::often_changed, which keeps the rate).
/// @param factors in the order they were flown
JointEstimate EstimateJointly(const std::vector<FlightFactor>& factors,
                              const JointOptions& options = {});

/// What the fleet says as parameters.yaml: shared parameters with sigma and scatter. Those that
/// every flight has its own of are predicted for a next one, from what the flights scatter about
/// and from the vehicle's prior.
/// @param model with which the flights were calibrated
ParameterSet ToParameterSet(const JointEstimate& joint, const std::vector<FlightFactor>& factors,
                            const DynamicModel& model);

}  // namespace odmc
