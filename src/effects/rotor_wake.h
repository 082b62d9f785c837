#pragma once

#include <cmath>

#include "dual.h"
#include "odmc/effects/blade_inflow.h"

/// \file
/// The wake of a rotor with its derivatives.

namespace odmc {

/// Induced velocity with its derivatives: those of 2 v W - BladeThrust() over its slope, which is
/// the implicit function theorem [m/s].
template <int N>
Dual<N> InducedVelocityWithSlope(const BladeFlow<Dual<N>>& flow) {
  const BladeFlow<double> plain{
      flow.in_plane_squared.v, flow.axial.v, flow.tip, flow.lift.v, flow.pitch.v,
      flow.pitch_at_half.v,    flow.given.v};
  const double v = InducedVelocity(plain);
  const Dual<N> excess = 2.0 * v * sqrt(DiscSpeedSquared(flow, v)) - BladeThrust(flow, v);
  return Dual<N>(v, -excess.d / InflowSlope(plain, v));
}

/// The skewed wake of a rotor whose thrust is known: by momentum theory, Glauert 1926 with the
/// vortex ring state (DiscSpeedSquared()).
template <int N>
struct RotorWake {
  /// Gradient of the inflow along the flight, v tan(χ/2), over the induced velocity of hover and
  /// over the in-plane air speed [s/m]. It is the first harmonic of the inflow by Coleman et al.
  /// 1945 and Pitt and Peters 1981: it grows with the skew and fades as v falls with speed.
  Dual<N> gradient;
};

/// @param in_plane_squared u_h² [m²/s²]
/// @param axial air speed along the rotor's axis, positive in climb [m/s]
/// @param hover_squared squared induced velocity of hover, thrust over 2 ρ A [m²/s²], > 0
template <int N>
RotorWake<N> WakeOf(const Dual<N>& in_plane_squared, const Dual<N>& axial,
                    const Dual<N>& hover_squared) {
  constexpr double kSmooth = 0.25;  // [m²/s²]: |w| is rounded off below 0.5 m/s
  BladeFlow<Dual<N>> flow;
  flow.in_plane_squared = in_plane_squared;
  flow.axial = axial;
  flow.given = 2.0 * hover_squared;
  const Dual<N> v = InducedVelocityWithSlope(flow), w = axial + v, through = w * w + kSmooth;
  const Dual<N> tan_half = 1.0 / (sqrt(in_plane_squared + through) + sqrt(through));
  return {v / sqrt(hover_squared) * tan_half};
}

}  // namespace odmc
