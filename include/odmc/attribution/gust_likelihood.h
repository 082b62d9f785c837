#pragma once

#include "odmc/attribution/residual.h"

namespace odmc {

/// Is a slowly varying force residual the wind acting on the vehicle's drag? Compares, by a Kalman
/// filter's likelihood, a first-order Gauss-Markov wind seen through the model's drag with a force
/// of the same kind fixed in the world and one fixed in the body, of any size along each axis, with
/// one that swings steadily, with one that follows the place, and with noise alone.
struct GustTest {
  double gain = 0.0;         ///< of gusts over noise alone, fitted with the same drag [nats]
  double over_others = 0.0;  ///< of gusts over the best of the free forces [nats]
  /// Of gusts over a force fixed in the world of which a part follows the place [nats].
  double over_place = 0.0;
  double sigma_m_s = 0.0;           ///< best standard deviation of the gusts along world x and y
  double vertical_sigma_m_s = 0.0;  ///< along world z
  double time_constant_s = 0.0;     ///< best correlation time
  /// Standard errors of these three over their values.
  double sigma_error = 0.0, vertical_sigma_error = 0.0, time_constant_error = 0.0;
  /// Change of each drag coefficient beside the gusts, and its sigma, in natural sizes.
  Eigen::VectorXd drag, drag_sigma;
  /// Chance that gusts of this size, which are normal, look as peaked: small for knocks.
  double peakedness_p = 1.0;
};

/// Derivatives of the predicted wrench by the wind along world x, y, z (N×6 each).
using WindDerivatives = std::array<ResidualModel::Wrenches, 3>;

/// A coefficient that shapes how the force answers wind, in units of its natural size, as a change
/// from its present value.
struct DragCoefficient {
  int index = -1;                    ///< in DynamicModel::parameters()
  double natural_size = 0.0;         ///< in the parameter's unit
  ResidualModel::Wrenches d_wrench;  ///< derivative of the predicted wrench (N×6)
  WindDerivatives d_wind;            ///< derivative of the derivatives by the wind
  double least = 0.0, most = 0.0;    ///< the change's bounds: the coefficient's physical sign
};

/// What is known of the correlation time of gusts before the flight: its logarithm is normal.
struct TimeConstantPrior {
  double median_s = 0.0;
  double log_sigma = 0.0;
};

/// Drag that is fitted beside gusts is off by more than noise explains, and wind seen through the
/// wrong drag loses to a free force: every hypothesis fits the drag for itself. Blocks held out are
/// not looked at.
/// @param residual force residual in columns 0 to 2 (N×6)
/// @param d_wind of the predicted force
/// @param drag what all hypotheses may change
/// @param prior of gusts and of the free forces alike
/// @param jobs hypotheses fitted at a time
GustTest TestGusts(const ThinnedFlight& flight, const ResidualModel::Wrenches& residual,
                   const WindDerivatives& d_wind, const std::vector<DragCoefficient>& drag,
                   const TimeConstantPrior& prior, int jobs = 1);

/// Wind in the world at each sample [m/s], by a Kalman filter that has seen all but the last
/// `ahead` samples before it.
/// @param residual,d_wind as above, without gusts
std::vector<Eigen::Vector3d> PredictGusts(const ThinnedFlight& flight,
                                          const ResidualModel::Wrenches& residual,
                                          const WindDerivatives& d_wind,
                                          const Eigen::Vector3d& sigma_m_s, double time_constant_s,
                                          int ahead);

}  // namespace odmc
