#pragma once

#include <Eigen/Core>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "odmc/model/dynamic_model.h"
#include "odmc/phases/flight_phase.h"
#include "odmc/sensing/samples.h"
#include "odmc/text/finding.h"

namespace odmc {

/// Where the odometry's recorded point lies, each frequency weighed by what the model leaves there.
/// A point r off the centre of mass shows in the force as m (dw/dt × r + w × (w × r)), at all
/// frequencies of the motion; what a model lacks of the air is slow. An estimate that takes all
/// errors for white noise follows the slow ones. docs/estimator.md, "The recorded point".
struct RecordedPoint {
  /// odometry_extrinsics.px, py, pz with the centre of gravity where it was taken to be; empty:
  /// `why` says so.
  std::optional<Eigen::Vector3d> p_m;
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();  ///< [m²]
  double low_Hz = 0.0, high_Hz = 0.0;                    ///< the frequencies that were looked at
  double flight_s = 0.0;                                 ///< that was looked at
  std::string why;
};

/// The point of a recorded flight, beside all of the model's estimated parameters that act on the
/// force.
/// @param file_vehicle the vehicle file as it is (nominal mounts)
/// @param values about which the model is linearized
/// @param ground_spans stamps that do not count
RecordedPoint FindRecordedPoint(const FlightLog& log, const Vehicle& file_vehicle,
                                const DynamicModel& model, const ModelValues& values,
                                const StampSpans& ground_spans);

/// The same of a flight whose model takes the point to be known, as the vehicle file has it; of a
/// long one, of its last minute.
RecordedPoint FindPointOfKnownMount(const FlightLog& log, const Vehicle& file_vehicle,
                                    const DynamicModel& model, const ModelValues& values,
                                    const StampSpans& ground_spans);

/// A remark where the point is another than the model takes to be known: by chance in less than one
/// flight in a thousand, by more than vehicles are measured to (5 mm), and by no more than their
/// size. Empty where the model estimates it.
/// @param sigma of the estimate, by index in the model's parameters
std::optional<Finding> PointRemark(const RecordedPoint& point, const DynamicModel& model,
                                   const ModelValues& values, const Eigen::VectorXd& sigma);

/// What is taken of a point: coordinates, and those of the centre of gravity that must be held with
/// them, since the force shows only how far one is from the other. By full name.
struct TakenPoint {
  std::map<std::string, ParameterSetting> point, held;
};

/// The coordinates that the flight shows: known to half the prior's sigma. An estimate that follows
/// slow errors of its model does not know by how much, so its sigma is not asked.
/// @param values, sigma of that estimate, by index in the model's parameters
TakenPoint TakePoint(const RecordedPoint& point, const DynamicModel& model,
                     const ModelValues& values, const Eigen::VectorXd& sigma);

}  // namespace odmc
