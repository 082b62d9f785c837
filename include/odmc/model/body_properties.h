#pragma once

#include <Eigen/Core>

#include "odmc/model/vehicle.h"

namespace odmc {

/// What the equations of motion need besides the wrench: the body, gravity, the air, the mounts.
/// Effects may shape it (centre_of_gravity, inertia, gravity, extrinsics, and later mass changes,
/// products of inertia, wind).
struct BodyProperties {
  double mass = 0.0;                                       ///< [kg]
  Eigen::Vector3d p_BBcm = Eigen::Vector3d::Zero();        ///< [m]
  Eigen::Matrix3d I_BBcm_B = Eigen::Matrix3d::Identity();  ///< [kg m²]
  Eigen::Vector3d g_W = Eigen::Vector3d::Zero();           ///< about (0, 0, -9.81) [m/s²]
  Eigen::Vector3d wind_W = Eigen::Vector3d::Zero();        ///< [m/s]
  Eigen::Vector3d p_BS = Eigen::Vector3d::Zero();          ///< odometry sensor from Bo, in B [m]
  Eigen::Matrix3d R_BS = Eigen::Matrix3d::Identity();
  Eigen::Vector3d p_BI = Eigen::Vector3d::Zero();  ///< IMU from Bo, in B [m]
  Eigen::Matrix3d R_BI = Eigen::Matrix3d::Identity();

  /// As the vehicle file says, before any effect.
  static BodyProperties Nominal(const Vehicle& vehicle);
};

/// Rows of the derivative of BodyProperties with respect to parameters. Inertia rows are
/// xx, yy, zz, xy, xz, yz; rotations are right perturbations R Exp(theta).
enum BodyPropertyRow : int {
  kRowMass = 0,
  kRowCom = 1,
  kRowInertia = 4,
  kRowGravity = 10,
  kRowWind = 13,
  kRowOdometryPosition = 16,
  kRowOdometryRotation = 19,
  kRowImuPosition = 22,
  kRowImuRotation = 25,
  kNumBodyPropertyRows = 28,
};

/// A run of those rows.
struct BodyPropertyRows {
  int first = 0, count = 0;
};

}  // namespace odmc
