#pragma once

#include <Eigen/Core>

#include "odmc/model/rotor_map.h"

namespace odmc {

/// How much of a wrench the rotors could give.
struct AllocationReport {
  double thrust_change_N = 0.0;   ///< thrust given beyond the one asked for
  double roll_pitch_share = 1.0;  ///< of the roll and pitch torque asked for
  double yaw_share = 1.0;         ///< of the yaw torque asked for

  bool saturated() const {
    return thrust_change_N != 0.0 || roll_pitch_share < 1.0 || yaw_share < 1.0;
  }
};

/// Squared rotor speeds that make a wrench, within limits and by priority. What the limits leave
/// no room for is given up in this order: yaw torque, then collective thrust (by as little as it
/// takes), then roll and pitch torque, scaled together so that the axis of the torque stays. A
/// vehicle that keeps its tilt under control survives a wrong height and a wrong heading.
class Allocation {
 public:
  /// @param map of a vehicle whose rotors make thrust and all three torques (rank 4) and can hover
  ///   level, all of them pushing up; else std::invalid_argument
  /// @param arm_length_m scales torques against the thrust where there are more than four rotors
  /// @param min_squared, max_squared limits of a squared speed, 0 <= min < max [rad²/s²]
  Allocation(const RotorMap& map, double arm_length_m, double min_squared, double max_squared);

  /// Squared speeds (n×1, rad²/s²), every one within the limits.
  /// @param wrench f_z, tau_x, tau_y, tau_z (about Bcm, in B)
  RotorVector SquaredSpeeds(const Eigen::Vector4d& wrench,
                            AllocationReport* report = nullptr) const;

  /// What squared speeds make: f_z, tau_x, tau_y, tau_z.
  Eigen::Vector4d WrenchOf(const RotorVector& squared_speeds) const {
    return map_ * squared_speeds;
  }

  double min_squared() const { return min_squared_; }
  double max_squared() const { return max_squared_; }

 private:
  // Change of thrust, in units of `lift_`, for which base + change * lift_ keeps the limits.
  struct Interval {
    double low, high;
  };
  Interval Room(const RotorVector& base) const;
  // Largest share of `tilt` for which thrust + share * tilt + any change of thrust keeps them.
  double TiltShare(const RotorVector& thrust, const RotorVector& tilt) const;
  double YawShare(const RotorVector& base, const RotorVector& yaw) const;

  RotorMap map_;
  Eigen::Matrix<double, Eigen::Dynamic, 4, 0, kMaxRotors, 4> inverse_;
  RotorVector lift_;  // squared speeds that make 1 N of thrust and no torque
  double min_squared_, max_squared_;
};

}  // namespace odmc
