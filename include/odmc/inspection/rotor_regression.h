#pragma once

#include <Eigen/Core>
#include <vector>

#include "odmc/inspection/rotor_blocks.h"

namespace odmc {

/// What a regression of spectra found, as a Gaussian.
struct BandRegression {
  Eigen::VectorXd value;        ///< p×1
  Eigen::MatrixXd information;  ///< inverse covariance, p×p
  double log_likelihood = 0.0;  ///< of what was seen, up to what regressions of it share
  double scatter = 1.0;         ///< of the blocks over the nominal one, which the information has

  /// Log likelihood over another regression's of the same, lowered as its information is.
  double LogRatio(const BandRegression& other) const {
    return (log_likelihood - other.log_likelihood) / other.scatter;
  }
};

/// The answer to each column if the motion follows the rotor stamps by `lag_s`. Torques are in the
/// nominal vehicle's units: a column's coefficient is the lever of its thrust [m], times the
/// nominal inertia over the true one.
struct RotorLag {
  double lag_s = 0.0;
  double log_likelihood = 0.0;  ///< of roll and pitch with free coefficients, over the likeliest's
  BandRegression roll, pitch;   ///< on the n squared speeds
  BandRegression yaw;           ///< on the n squared speeds, then on twice the n rotor
                                ///< accelerations over the typical speed [m], [m s]
};

/// How the vehicle answers each column of the rotor speeds.
struct RotorResponse {
  int blocks = 0;                ///< of flight; 0: nothing is known, and the rest is empty
  double hover_squared = 0.0;    ///< typical squared speed of a rotor [rad²/s²]
  std::vector<RotorLag> lags;    ///< that the flight leaves possible, the likeliest first
  Eigen::VectorXd share;         ///< of each column in the sum of squared speeds, n×1
  Eigen::MatrixXd share_spread;  ///< covariance of the mean share, n×n
};

/// Regresses angular acceleration on squared rotor speeds and rotor accelerations between 2 and 15
/// Hz, at every lag between the two streams, with the noise's spectrum and a weight for every block
/// (Student's t, so that crashes and jumps are outvoted) found along the way. The information
/// counts half-overlapping blocks half, and is lowered to what the scatter of the blocks shows.
///
/// The readings' own noise (RotorBlocks::noise) is taken out of the regressors: in each bin they
/// are the best linear estimate of the true speeds. Without this a gentle flight, whose rotors
/// hardly differ from each other, shows coefficients near zero, and a lag at which the controller's
/// answer to the motion looks like its cause.
RotorResponse MeasureRotorResponse(const RotorBlocks& blocks, const Vehicle& vehicle);

}  // namespace odmc
