#pragma once

#include <Eigen/Core>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "odmc/control/flatness_controller.h"
#include "odmc/control/parameter_handover.h"
#include "odmc/estimator/acceptance.h"
#include "odmc/estimator/estimator.h"
#include "odmc/phases/flight_phase.h"
#include "odmc/sim/world.h"
#include "odmc/trajectory/trajectory.h"

namespace odmc {

/// A flight with the estimator in the loop, and everybody's idea of the vehicle.
struct ControlledFlightSetup {
  Vehicle vehicle;                                  ///< what estimator and controller start from
  std::shared_ptr<const DynamicModel> truth_model;  ///< what flies
  ModelValues truth;                                ///< its values
  TrajectoryOptions trajectory;
  WorldOptions world;
  ControllerOptions controller;
  HandoverOptions handover;
  EstimatorOptions estimator;
  AcceptanceOptions acceptance;
  double control_rate_hz = 500.0;
  std::optional<ParameterSet> warm_start;  ///< saved from an earlier flight: offered at the start
  bool estimates = true;             ///< false: the controller keeps the vehicle file's parameters
  double estimator_dies_at_s = 0.0;  ///< killed in flight; 0: never
  /// Flown by throttles: the controller inverts the actuator of `vehicle`, what flies is that of
  /// `truth_model`.
  bool by_throttle = false;
  /// Estimator and controller get rotor speeds from commands and battery voltage by the actuator of
  /// `vehicle`; those of the sensor are recorded only.
  bool rotor_speed_from_commands = false;
  int seed = 1;
};

/// Where the vehicle was and where it should have been.
struct TrackingSample {
  double t_s = 0.0;
  bool counts = false;             ///< flying its path: 2 s after take-off to the end of the path
  Eigen::Vector3d p_WB, p_WB_ref;  ///< truth and reference [m]
  Eigen::Vector3d v_WB;            ///< truth [m/s]
  HandoverState handover = HandoverState::kNominal;
};

/// Tracking errors of some samples, along W.
struct TrackingErrors {
  Eigen::Vector3d rmse_m = Eigen::Vector3d::Zero();
  Eigen::Vector3d max_m = Eigen::Vector3d::Zero();  ///< largest absolute value
};

/// What a controlled flight left behind.
struct ControlledFlight {
  std::vector<TrackingSample> samples;  ///< 100 a second
  std::vector<HandoverEvent> handover;
  std::optional<ParameterSet> accepted;  ///< the newest estimate that was accepted
  double first_accepted_s = 0.0;         ///< 0: never
  FlightLog log;                         ///< what the sensors said
  StampSpans ground_spans;
  std::string crash;  ///< what happened; empty: it flew
  double take_off_s = 0.0;
  double largest_tilt_rad = 0.0;
  double control_ms_p99 = 0.0;  ///< wall time of one controller step
  double flown_s = 0.0, wall_s = 0.0;
  double battery_end_V = 0.0;
};

/// Flies in lock-step, without ROS, until the trajectory ends, the vehicle crashes or (for
/// trajectories without end) `longest_s` have passed. The same setup gives the same flight, except
/// for the times it took. A crash is contact with the ground outside take-off and landing, a tilt
/// above 120 deg or an error above 2 m.
/// @throws std::invalid_argument for options that are not valid, and for throttles or rotor speeds
///   from commands without the actuators these take
ControlledFlight FlyControlled(const ControlledFlightSetup& setup, double longest_s = 60.0);

/// Errors of the samples that count and lie in [from_s, to_s).
TrackingErrors ErrorsBetween(const ControlledFlight& flight, double from_s, double to_s);
/// Of all that count.
TrackingErrors ErrorsOf(const ControlledFlight& flight);

}  // namespace odmc
