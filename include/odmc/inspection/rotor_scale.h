#pragma once

#include <optional>
#include <vector>

#include "odmc/inspection/rotor_regression.h"
#include "odmc/inspection/stream_doubt.h"
#include "odmc/text/finding.h"

namespace odmc {

/// The rotor whose readings fit the others least.
struct RotorScale {
  bool tested = false;          ///< false: too little flight to say anything
  int rotor = 0;                ///< from 0
  std::optional<int> or_rotor;  ///< another that explains nearly as much
  double factor = 1.0;          ///< reading over what its thrust says
  double sigma = 0.0;           ///< of the factor
  double significance = 0.0;    ///< of a factor other than one [sigmas]
  double effects_say = 0.0;     ///< the same by the effects alone; below 0: they say the opposite
  double steady_says = 0.0;     ///< by steady balance alone
  double k_f_shift = 0.0;       ///< relative error of k_f that follows
  bool reads_zero = false;      ///< it hardly reads anything: no factor then
  std::vector<StreamDoubt> doubts;  ///< of each rotor whose reading may be off
};

/// Looks for one rotor whose readings are scaled, without commands to compare with. Two witnesses:
/// the effect of each column on roll and pitch acceleration beside those of the others, and steady
/// flight, in which the torques about all three axes balance. A centre of gravity beside the file's
/// tips roll and pitch, but neither yaw nor the effects. A damaged propeller looks the same as a
/// sensor that reads high.
RotorScale FindRotorScale(const RotorResponse& response, const Vehicle& vehicle);

/// Check "rotor_scale", if one is significant.
std::vector<Finding> ScaleFindings(const RotorScale& scale, const Vehicle& vehicle);

}  // namespace odmc
