#pragma once

#include <array>
#include <optional>

#include "odmc/attribution/residual.h"

namespace odmc {

/// A moment of inertia about one body axis.
struct InertiaEstimate {
  double value_kg_m2 = 0.0, sigma_kg_m2 = 0.0;
};

/// Moments of inertia by instrumental variables, where the flight shows them.
///
/// Rotor torque and angular acceleration are both measured with noise. Regressed the one way that
/// noise makes the inertia too large, the other way too small, and on a small vehicle it is as
/// large as the torque itself. Per axis the torque balance
///
///   tau_rotors = I dw/dt + b w + m_z T + (moments of air speed and of other axes' rates) + noise
///
/// is solved with the acceleration replaced by what accelerations and torques more than one filter
/// window before and after say of it: these share the motion with it and none of its noise
/// (two-stage least squares; Wooldridge, Econometric Analysis of Cross Section and Panel Data, 2010,
/// ch. 5). Sigma is by blocks of one second, whatever the noise's colour.
///
/// @param k_f, k_m thrust and torque coefficient [N s², N m s²]
/// @returns per axis; empty where the instruments say too little of the acceleration (first-stage F
///   below 10: Staiger and Stock, Econometrica 1997)
std::array<std::optional<InertiaEstimate>, 3> InstrumentedInertia(const ThinnedFlight& flight,
                                                                  const Vehicle& vehicle,
                                                                  double k_f, double k_m);

}  // namespace odmc
