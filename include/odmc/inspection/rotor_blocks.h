#pragma once

#include <Eigen/Core>
#include <vector>

#include "odmc/model/vehicle.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// One second of flight as a spectrum: what the rotors did, and how the body turned.
struct RotorBlock {
  double start_s = 0.0;          ///< since the first pose
  Eigen::MatrixXcd turn;         ///< angular acceleration of B in B, bins×3 [rad/s²]
  Eigen::MatrixXcd squared;      ///< squared rotor speeds, bins×n [rad²/s²]
  Eigen::MatrixXcd spin_up;      ///< rotor accelerations, bins×n [rad/s²]
  Eigen::VectorXd mean_squared;  ///< mean of the squared speeds, n×1 [rad²/s²]
  Eigen::MatrixXd sample_power;  ///< of the samples of the speeds, bands×n: that of white noise is
                                 ///< its variance in every band [rad²/s²]
};

/// Spectra of a flight between 2 and 15 Hz. Below, a controller answers disturbances, and the
/// regression of turning on rotor speeds shows the controller instead of the vehicle; above, there
/// is more noise than motion.
struct RotorBlocks {
  std::vector<double> omega;       ///< angular frequency of each bin [rad/s]
  std::vector<RotorBlock> blocks;  ///< those in which the rotors turn at flight speeds
  /// Power of the readings' noise in `squared`, bins×n [rad⁴/s⁴]: of noise that is white from
  /// sample to sample, as much as the band with the least power of the samples' whole spectrum
  /// allows.
  Eigen::MatrixXd noise;
};

/// Cuts a flight into blocks of a second, half overlapping, without gaps in rotor speeds or body
/// rates. Rates come from the gyro, else from the odometry's twist, else from its attitude.
/// Derivatives are taken in the spectrum, exactly. Long flights are thinned evenly to at most 300
/// blocks. Empty where a stream is missing, too slow (below 15 Hz) or only the RMS of the speeds is
/// known.
RotorBlocks CutRotorBlocks(const FlightLog& log, const Vehicle& vehicle);

}  // namespace odmc
