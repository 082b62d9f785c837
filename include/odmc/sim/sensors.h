#pragma once

#include <Eigen/Core>

#include "odmc/math/gaussian.h"
#include "odmc/model/body_properties.h"
#include "odmc/sensing/samples.h"
#include "odmc/sim/truth_sample.h"

namespace odmc {

/// Standard deviations of one odometry sample, per axis.
struct OdometryErrors {
  double position_m = 0.0;
  double attitude_rad = 0.0;  ///< right perturbation of q_WS
  double velocity_m_s = 0.0;
  double rate_rad_s = 0.0;
};

/// Errors of one IMU sample, in I.
struct ImuErrors {
  double gyro_rad_s = 0.0;                                       ///< standard deviation per axis
  double accelerometer_m_s2 = 0.0;                               ///< standard deviation per axis
  Eigen::Vector3d gyro_bias = Eigen::Vector3d::Zero();           ///< [rad/s]
  Eigen::Vector3d accelerometer_bias = Eigen::Vector3d::Zero();  ///< [m/s²]
};

/// Pose and twist of the sensor frame S of a vehicle in `state`, exact.
OdometrySample OdometryOf(Stamp stamp, const RigidBodyState& state,
                          const BodyProperties& properties);

/// What an IMU at frame I feels, exact.                                         model.md Eq. (C)
ImuSample ImuOf(const TruthSample& truth, const BodyProperties& properties);

/// Each draws the same count of numbers whatever the size of the noise.
void AddNoise(const OdometryErrors& noise, Gaussian* random, OdometrySample* sample);
void AddNoise(const ImuErrors& noise, Gaussian* random, ImuSample* sample);
/// White noise of standard deviation `sigma` [rad/s]; a rotor at rest is seen to rest.
void AddNoise(double sigma, Gaussian* random, RotorVector* speed);

}  // namespace odmc
