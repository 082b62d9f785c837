#pragma once

#include <string>

#include "odmc/model/vehicle.h"

namespace odmc {

/// What Bayes' rule says about units in a vehicle file.
struct UnitError {
  double file_share = 1.0;  ///< probability that no quantity is in another unit
  double best_share = 0.0;  ///< probability of the likeliest slip
  std::string what;         ///< "rotor positions (position_m) are in mm"
  std::string mend;         ///< "divide them by 1000"

  /// True if the file's units are refuted: a file of right units is accused once in 10 000.
  bool Refutes() const { return file_share < 1e-4; }
  /// "rotor positions (position_m) are in mm (probability 0.999); divide them by 1000".
  std::string Sentence() const;
};

/// Weighs slips of units (inertia in g cm², positions in mm or ten times too large, mass in g, ...)
/// against a file that is right, by three ratios in which multirotors are alike whatever their
/// size: propeller radius over arm, inertia over mass times arm², mass over propeller area.
/// @pre mass, inertia, arms and radii are positive
UnitError FindUnitError(const Vehicle& vehicle);

}  // namespace odmc
