#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "odmc/factors/state.h"
#include "odmc/model/dynamic_model.h"
#include "odmc/window/window_solver.h"

namespace odmc {

/// Wall and CPU time of one update [ms], and what they depend on.
struct UpdateTiming {
  double wall_ms = 0.0;
  double cpu_ms = 0.0;
  // Wall time of the stages of an update, in their order; their sum is wall_ms.
  double read_ms = 0.0;         ///< synchronise the streams, look for the ground, preintegrate
  double build_ms = 0.0;        ///< the keyframe and its factors
  double solve_ms = 0.0;        ///< the window
  double snapshot_ms = 0.0;     ///< covariances, residuals
  double marginalize_ms = 0.0;  ///< the oldest keyframe; statistics of its residual
  int states = 0;               ///< in the window
  // As in SolveReport.
  int eliminated = 0;
  bool sweeping = false, aligned = false;
};

/// Where the estimate stands after one update.
struct Snapshot {
  Stamp stamp = 0;      ///< of the newest keyframe
  double time_s = 0.0;  ///< since the first keyframe
  bool airborne = false;
  State state;  ///< newest keyframe, sensor frame S
  /// Of its tangent (p, theta, v, w), not inflated; NaN where a direction is not known.
  WindowSolver::StateMatrix state_covariance;
  BodyProperties body;    ///< at the estimate: mounts, centre of mass, gravity
  ModelValues values;     ///< of the model's parameters
  Eigen::VectorXd sigma;  ///< of each, 0 where frozen; inflated for serial correlation
  /// Of each, at least 1: `sigma` over what the window's information alone gives.
  Eigen::VectorXd inflation;
  std::vector<bool> observable;
  std::vector<std::string> unobservable;  ///< directions nobody measured, in words
  Eigen::MatrixXd covariance;             ///< of all parameters, 0 where frozen
  SolveReport solve;
  UpdateTiming timing;
  Eigen::Vector3d residual_force_B = Eigen::Vector3d::Zero();   ///< newest interval [N]
  Eigen::Vector3d residual_torque_B = Eigen::Vector3d::Zero();  ///< newest interval [N m]
  double residual_force_rms_N = 0.0;    ///< running, about a window long, all axes
  double residual_torque_rms_Nm = 0.0;  ///< running, about a window long, all axes
  double battery_voltage_V = 0.0;
};

}  // namespace odmc
