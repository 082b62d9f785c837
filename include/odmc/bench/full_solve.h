#pragma once

#include <optional>
#include <string>

#include "odmc/estimator/estimator.h"

namespace odmc {

/// How far an estimate is from that of a batch solve of the same window to convergence.
struct FullSolveDifference {
  double parameters = 0.0;  ///< largest, in standard deviations of the full solve
  double sigmas = 0.0;      ///< largest relative difference of a standard deviation
  std::string worst_parameter, worst_sigma;  ///< full names
};

/// Solves a window that an update has solved once more with Ceres, to convergence, and leaves it as
/// it was. @returns nothing without states, or where a solve failed
std::optional<FullSolveDifference> CompareWithFullSolve(const SolvedWindow& solved);

}  // namespace odmc
