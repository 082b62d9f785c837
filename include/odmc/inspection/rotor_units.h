#pragma once

#include <optional>
#include <string>
#include <vector>

#include "odmc/model/vehicle.h"
#include "odmc/sensing/samples.h"
#include "odmc/text/finding.h"

namespace odmc {

/// What Bayes' rule says about the unit of the rotor speeds.
struct RotorUnit {
  double declared_share = 1.0;  ///< probability of rad/s
  double best_share = 0.0;
  std::string best;     ///< "rpm", "erpm of 7 pole pairs (14 poles)"
  std::string or_best;  ///< the next ones, where they are not much less likely; or empty
  std::string mend;

  /// Speeds that are in rad/s are refuted once in 10 000 recordings.
  bool Refutes() const { return declared_share < 1e-4; }
};

/// Weighs rad/s, rpm, krpm, turns per second, deg/s, and eRPM and electric rad/s of 2 to 14 pole
/// pairs. Each says what the thrust coefficient would be; most vehicle files know that within their
/// own sigma, and those that do not still have propellers of a known size. Says nothing where the
/// file has no thrust.k_f.
/// @param carrying_k_f coefficient with which the thrust of the numbers as they are carries the
/// mass
RotorUnit FindRotorUnit(double carrying_k_f, const Vehicle& vehicle);

/// Check "rotor_unit", if the unit is refuted.
std::optional<Finding> RotorUnitFinding(double carrying_k_f, const Vehicle& vehicle);

/// The same for readings that no rotor has in rad/s, which readers drop: to be asked before.
/// @returns a sentence; empty if fewer than half of the readings are so
std::string ImpossibleRotorUnit(const FlightLog& log, const Vehicle& vehicle);

}  // namespace odmc
