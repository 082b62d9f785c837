#pragma once

namespace odmc {

/// A propeller and the turning part of an outrunner motor, by what a scale and a ruler give.
struct RotorGeometry {
  int blades = 2;
  double blade_mass_kg = 0.0;   ///< of one blade
  double blade_length_m = 0.0;  ///< from the axis to the tip
  double bell_mass_kg = 0.0;    ///< of the bell with its magnets
  double bell_radius_m = 0.0;   ///< outer radius
};

/// Moment of inertia about the axis [kg m²]: blades as slender rods from the axis to the tip
/// (m l²/3 each), the bell as a thin ring with most of its mass at the rim (m r², the flat end
/// counts as a third of the mass at half the square). Good to about 20 %.
double RotorInertia(const RotorGeometry& geometry);

}  // namespace odmc
