#pragma once

#include <Eigen/Core>
#include <optional>
#include <utility>
#include <vector>

#include "odmc/estimator/load_observer.h"
#include "odmc/model/dynamic_model.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// Smoothed motion of the odometry sensor and of the rotors at one sample.
struct FilteredMotion {
  double t_s = 0.0;  ///< since the first odometry sample
  Eigen::Matrix3d R_WS;
  Eigen::Vector3d p_WS;          ///< [m]
  Eigen::Vector3d v_WS, a_WS;    ///< velocity and acceleration of So in W [m/s, m/s²]
  Eigen::Vector3d w_S, w_dot_S;  ///< angular rate and acceleration in S [rad/s, rad/s²]
  RotorState rotors;
  std::optional<Eigen::Vector3d> specific_force_I;  ///< of the accelerometer, if any [m/s²]
  bool follows = false;  ///< the sample before it is the recording's sample before it
};

/// A recording's airborne motion through one Savitzky-Golay filter (order 3, odd count nearest
/// 0.1 s). Missing velocity: derivatives of position; missing rates: of the quaternion. Samples on
/// the ground or within one filter window of a gap are left out and counted.
struct FlightMotion {
  std::vector<FilteredMotion> samples;
  double step_s = 0.0;  ///< median of the odometry
  long left_out_gaps = 0;
  long left_out_ground = 0;
};

FlightMotion FilterFlight(const FlightLog& log, int num_rotors,
                          const std::vector<std::pair<Stamp, Stamp>>& ground_spans);

/// Pull of a suspended load per unit of load at every sample, in W [m/s²]; hanging still without
/// one. How it swings at the odometry's first sample is in the model's values.
std::vector<Eigen::Vector3d> LoadPulls(const FlightMotion& flight, const DynamicModel& model,
                                       const ModelValues& values);

}  // namespace odmc
