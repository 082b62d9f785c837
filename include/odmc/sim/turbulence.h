#pragma once

#include <Eigen/Core>

#include "odmc/math/gaussian.h"

namespace odmc {

/// Dryden turbulence at low altitude, MIL-F-8785C: white noise through
///   H_u = sigma √(2L/V) / (1 + L s/V)                        along the mean wind,
///   H_v = sigma √(L/V) (1 + √3 L s/V) / (1 + L s/V)²         across it and upwards,
/// with one standard deviation and one length for all axes. Exact at any step: in the distance
/// flown over L the filters do not change with airspeed.
class Turbulence {
 public:
  /// @param sigma_m_s >= 0  @param length_m > 0
  Turbulence(double sigma_m_s, double length_m, int seed);

  /// Moves on by `dt` at an airspeed [m/s]; steps above half a length count as half.
  void Advance(double airspeed, double dt);

  /// Along the mean wind, across to its left, upwards [m/s].
  Eigen::Vector3d velocity() const;

 private:
  // State of H_v: white noise through 1/(1+s), and that through 1/(1+s) again.
  struct SecondOrder {
    double once, twice;
  };

  double sigma_, length_;
  Gaussian random_;
  double along_;
  SecondOrder across_, up_;
};

}  // namespace odmc
