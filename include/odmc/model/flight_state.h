#pragma once

#include <Eigen/Core>

#include "odmc/model/pendulum.h"
#include "odmc/model/vehicle.h"

namespace odmc {

/// Rotor speeds reduced over one interval (model.md section 4), one value per rotor.
struct RotorState {
  RotorVector speed_squared;       ///< mean of the squared speed [rad²/s²]
  RotorVector speed;               ///< mean speed [rad/s]
  RotorVector acceleration;        ///< mean rate of the speed [rad/s²]
  RotorVector speed_squared_rate;  ///< mean rate of the squared speed [rad²/s³]

  /// All four for speeds that do not change.
  static RotorState Steady(const RotorVector& speed_rad_s);
};

/// Everything an effect may look at, at one instant or for the middle of one interval.
struct FlightState {
  double time_s = 0.0;
  Eigen::Matrix3d R_WB = Eigen::Matrix3d::Identity();
  Eigen::Vector3d p_WB = Eigen::Vector3d::Zero();    ///< Bo in W [m]
  Eigen::Vector3d v_AB_B = Eigen::Vector3d::Zero();  ///< Bo relative to the air, in B [m/s]
  Eigen::Vector3d w_WB_B = Eigen::Vector3d::Zero();  ///< [rad/s]
  RotorState rotors;
  LoadPull load;  ///< of a suspended load; see Pendulum
};

}  // namespace odmc
