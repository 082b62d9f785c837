#pragma once

#include <algorithm>
#include <cmath>

/// \file
/// The induced velocity of a rotor: where the thrust of its blades is the momentum of its wake.
/// Formulas and their sources: docs/effects.md, "Blade elements and momentum".

namespace odmc {

/// The air a rotor meets and what its blades make of it, uniform over the disc. T is double or a
/// number with derivatives.
template <typename T>
struct BladeFlow {
  T in_plane_squared;  ///< squared air speed in the rotor's plane [m²/s²]
  T axial;             ///< air speed along the rotor's axis, positive in climb [m/s]
  double tip = 0.0;    ///< speed of the blades' tips [m/s], >= 0
  T lift;              ///< lift slope times solidity, σa, > 0
  T pitch;             ///< at three quarters of the radius [rad]
  T pitch_at_half;     ///< at half the radius [rad]
  T given = T(0.0);    ///< thrust over ρA that does not follow the air [m²/s²]
};

/// Thrust of the blades over ρA for an induced velocity v [m²/s²]: blade-element theory of rigid
/// blades with linear twist, small angles, mean over a turn (Leishman 2006, ch. 3), and what is
/// given.
template <typename T, typename V>
auto BladeThrust(const BladeFlow<T>& flow, const V& v) {
  return flow.given +
         0.5 * flow.lift *
             (flow.tip * flow.tip / 3.0 * flow.pitch +
              0.5 * flow.in_plane_squared * flow.pitch_at_half - 0.5 * flow.tip * (flow.axial + v));
}

/// Square of the speed W at which air passes the disc [m²/s²]: W² = in-plane² + (axial + v)²,
/// Glauert 1926, and in slow descent what the vortex ring state adds, with d = max(0, -axial), ξ =
/// v/d and t = ξ - 1/2: d² t² (2 - 2.5 t) / (1 + 5 t³) · d² / (d² + 4 in-plane²) for t > 0.
/// Glauert's thrust 2 ρ A v W has a valley there, between windmill and hover, with up to three v to
/// one thrust; with the term it rises with v everywhere. The constants come closest, among those
/// with which it does, to the mean of the measured curves (Leishman 2006, ch. 2: within 0.11
/// hover's induced velocity RMS). A rotor that pushes down is the same one upside down.
template <typename T, typename V>
auto DiscSpeedSquared(const BladeFlow<T>& flow, const V& v) {
  constexpr double kLeast = 1e-4;         // [m²/s²], keeps the root smooth in still air
  constexpr double kLeastDescent = 1e-6;  // [m/s]
  const double sign = v < 0.0 ? -1.0 : 1.0;
  auto square = flow.in_plane_squared + (flow.axial + v) * (flow.axial + v) + kLeast;
  if (-sign * flow.axial < kLeastDescent) return square;
  const auto d = -sign * flow.axial;
  const auto t = sign * v - 0.5 * d;  // times d
  if (t < 0.0) return square;
  return decltype(square)(square + d * d * d * d / (d * d + 4.0 * flow.in_plane_squared) * t * t *
                                       (2.0 * d - 2.5 * t) / (d * d * d + 5.0 * t * t * t));
}

/// The induced velocity v [m/s] at which 2 v W is BladeThrust(); the only one, for 2 v W rises and
/// the blades' thrust falls with v. Newton's method within a bracket that shrinks with every step,
/// halved where Newton leaves it: ends for every finite flow.
/// @param steps counts the evaluations, may be null
double InducedVelocity(const BladeFlow<double>& flow, int* steps = nullptr);

/// Slope of 2 v W - BladeThrust() by v [m/s], > 0 at the root.
double InflowSlope(const BladeFlow<double>& flow, double v);

}  // namespace odmc
