#pragma once

#include <optional>
#include <string>
#include <vector>

#include "odmc/sensing/samples.h"

namespace odmc {

/// \file
/// A log without poses beside a recording of them by another clock: motion capture, VIO.

/// What brings the poses' stamps to the gyro's clock.
struct ClockOffset {
  double offset_s = 0.0;  ///< to be added to the stamps of the poses
  double sigma_s = 0.0;
  double explained = 0.0;  ///< share of the rates' variance that the gyro explains there
};

/// Finds where the gyro's rates and the turns of the poses fit. Both are of one body, in frames
/// that are turned against each other by some constant. First by the speed of turning, over all
/// offsets at which they overlap; the best of these by all axes; then to a part of a sample by
/// generalised least squares (lag_regression.h), which gives the sigma, too.
/// @throws std::invalid_argument where the motion does not tell: no gyro, less than 5 s of it,
/// rates
///   that the gyro does not explain by half anywhere, or several places that fit alike
ClockOffset FindClockOffset(const std::vector<ImuSample>& imu,
                            const std::vector<OdometrySample>& poses);

/// Gives a log the poses of another recording, in the place of its own where it has some; those
/// outside the log's other streams are left out. A line about the offset goes to its warnings.
/// @param poses     of the other recording, with its warnings
/// @param offset_s  to be added to the stamps of the poses; found where it is not given
/// @throws std::invalid_argument naming both files
void JoinOdometry(const FlightLog& poses, std::optional<double> offset_s, FlightLog* log);

}  // namespace odmc
