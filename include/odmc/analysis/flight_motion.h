#pragma once

#include <Eigen/Core>
#include <functional>
#include <optional>
#include <vector>

#include "odmc/estimator/load_observer.h"
#include "odmc/model/dynamic_model.h"
#include "odmc/phases/flight_phase.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// What a gyro tells of the motion, smoothed, in the IMU's axes and with its bias.
struct GyroMotion {
  Eigen::Vector3d w_I, w_dot_I;  ///< angular rate and acceleration [rad/s, rad/s²]
};

/// Smoothed motion of the odometry sensor and of the rotors at one sample.
struct FilteredMotion {
  double t_s = 0.0;  ///< since the first odometry sample
  Eigen::Matrix3d R_WS;
  Eigen::Vector3d p_WS;          ///< [m]
  Eigen::Vector3d v_WS, a_WS;    ///< velocity and acceleration of So in W [m/s, m/s²]
  Eigen::Vector3d w_S, w_dot_S;  ///< angular rate and acceleration in S [rad/s, rad/s²]
  RotorState rotors;
  std::optional<Eigen::Vector3d> specific_force_I;  ///< of the accelerometer, if any [m/s²]
  std::optional<GyroMotion> gyro;                   ///< if any
  bool follows = false;  ///< the sample before it is the recording's sample before it
};

/// What FilterEach() says of a whole flight.
struct MotionCounts {
  double step_s = 0.0;  ///< median of the odometry
  long left_out_gaps = 0;
  long left_out_ground = 0;
};

/// A recording's airborne motion through one Savitzky-Golay filter (order 3, odd count nearest
/// 0.1 s). Missing velocity: derivatives of position; missing rates: of the quaternion. Samples on
/// the ground or within one filter window of a gap are left out and counted.
struct FlightMotion : MotionCounts {
  std::vector<FilteredMotion> samples;
  std::optional<double> stood_z_m;  ///< StandingHeight(), where somebody has asked for it
};

/// Shows every sample of it to `use`, and holds no more of the flight than some blocks of it.
MotionCounts FilterEach(const FlightLog& log, int num_rotors, const StampSpans& ground_spans,
                        const std::function<void(const FilteredMotion&)>& use);

FlightMotion FilterFlight(const FlightLog& log, int num_rotors, const StampSpans& ground_spans);

/// Height of So in W while the vehicle stands on the ground [m]: the median over the phases in
/// which it stands.
/// @param within_m between the 5th and the 95th percentile at most; empty where it is more (it has
///   stood here and there), or where the vehicle stands for less than half a second
std::optional<double> StandingHeight(const FlightLog& log, const std::vector<PhaseSpan>& phases,
                                     double within_m);

/// Adds to what is left out the spans of flight in which a vehicle may touch the ground it stands
/// on (StandingHeight()): no higher than its arms reach down as it leans, and 2 cm for errors of
/// the position; a filter window more on either side. None where that is more than a tenth of the
/// time in the air: what flies there for so long does not touch anything.
void AddGroundTouches(const FlightLog& log, const std::vector<PhaseSpan>& phases,
                      const Vehicle& vehicle, StampSpans* left_out);

/// Pull of a suspended load per unit of load, sample by sample of one flight.
class LoadForceEvaluator {
 public:
  explicit LoadForceEvaluator(const DynamicModel& model) : load_(model, false) {}

  /// At the next sample, in W [m/s²]. @param body properties by `values`, where the caller has them
  Eigen::Vector3d PullAt(const FilteredMotion& now, const ModelValues& values,
                         const BodyProperties* body = nullptr);

 private:
  LoadObserver load_;
  bool is_first_ = true;
  double t_s_ = 0.0;
  SensorMotion last_;
};

/// Pull of a suspended load per unit of load at every sample, in W [m/s²]; hanging still without
/// one. How it swings at the odometry's first sample is in the model's values.
std::vector<Eigen::Vector3d> LoadPulls(const FlightMotion& flight, const DynamicModel& model,
                                       const ModelValues& values);

}  // namespace odmc
