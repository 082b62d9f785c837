#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <optional>

#include "odmc/math/ring.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// Gyro and accelerometer of one interval.
struct ImuInterval {
  double dt = 0.0;  ///< [s]

  bool has_gyro = false;
  Eigen::Quaterniond delta_q;   ///< R_I(from)ᵀ R_I(to) by the gyro, with `bias_lin` taken off
  Eigen::Matrix3d d_bias;       ///< d Log(delta_q ...) right tangent / d gyro bias (3×3) [s]
  Eigen::Vector3d bias_lin;     ///< [rad/s]
  Eigen::Vector3d gyro_at_end;  ///< measured rate at the interval's end, with bias [rad/s]

  bool has_accelerometer = false;
  Eigen::Vector3d mean_specific_force;  ///< over the interval, with bias, in I [m/s²]

  int num_samples = 0;
};

/// Integrates raw samples over [from, to] (midpoint rule, interpolated ends). Empty if they do not
/// cover it or leave a hole longer than `max_hole_s`.
/// @param gyro_bias taken off before integrating; later changes go through `d_bias`
std::optional<ImuInterval> PreintegrateImu(const Ring<ImuSample>& samples, Stamp from, Stamp to,
                                           const Eigen::Vector3d& gyro_bias, double max_hole_s);

}  // namespace odmc
