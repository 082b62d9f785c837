#pragma once

#include <Eigen/Core>
#include <vector>

#include "odmc/inspection/rotor_blocks.h"

namespace odmc {

/// What a regression of spectra found, as a Gaussian.
struct BandRegression {
  Eigen::VectorXd value;        ///< p×1
  Eigen::MatrixXd information;  ///< inverse covariance, p×p
  double log_noise = 0.0;       ///< sum over blocks and bins of the log of the noise's power
};

/// How the vehicle answers each column of the rotor speeds. Torques are in the nominal vehicle's
/// units: a column's coefficient is the lever of its thrust [m], times the nominal inertia over the
/// true one.
struct RotorResponse {
  int blocks = 0;                ///< of flight; 0: nothing is known, and the rest is empty
  double lag_s = 0.0;            ///< the motion follows the rotor stamps by this
  double hover_squared = 0.0;    ///< typical squared speed of a rotor [rad²/s²]
  BandRegression roll, pitch;    ///< on the n squared speeds
  BandRegression yaw;            ///< on the n squared speeds, then on twice the n rotor
                                 ///< accelerations over the typical speed [m], [m s]
  Eigen::VectorXd share;         ///< of each column in the sum of squared speeds, n×1
  Eigen::MatrixXd share_spread;  ///< covariance of the mean share, n×n
};

/// Regresses angular acceleration on squared rotor speeds and rotor accelerations between 2 and 15
/// Hz, with the lag between the two streams, the noise's spectrum and a weight for every block
/// (Student's t, so that crashes and jumps are outvoted) found along the way. The information
/// counts half-overlapping blocks half, and is lowered to what the scatter of the blocks shows.
RotorResponse MeasureRotorResponse(const RotorBlocks& blocks, const Vehicle& vehicle);

}  // namespace odmc
