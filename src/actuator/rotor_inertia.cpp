#include "odmc/actuator/rotor_inertia.h"

namespace odmc {

double RotorInertia(const RotorGeometry& g) {
  constexpr double kRimShare = 2.0 / 3.0;  // of the bell's mass; its end is a disc
  const double blade = g.blade_mass_kg * g.blade_length_m * g.blade_length_m / 3.0;
  const double rim = kRimShare * g.bell_mass_kg * g.bell_radius_m * g.bell_radius_m;
  const double disc = 0.5 * (1.0 - kRimShare) * g.bell_mass_kg * g.bell_radius_m * g.bell_radius_m;
  return g.blades * blade + rim + disc;
}

}  // namespace odmc
