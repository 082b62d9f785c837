#pragma once

#include "odmc/attribution/residual.h"

namespace odmc {

/// Is a slowly varying force residual the wind acting on the vehicle's drag? Compares, by a Kalman
/// filter's likelihood, a first-order Gauss-Markov wind seen through the model's drag with a force
/// of the same kind fixed in the world and one fixed in the body, and with noise alone.
struct GustTest {
  double gain = 0.0;           ///< of gusts over noise alone [nats]
  double over_others = 0.0;    ///< of gusts over the better of the two free forces [nats]
  double sigma_m_s = 0.0;      ///< best standard deviation of the gusts
  double time_constant_s = 0;  ///< best correlation time
  double one_sidedness = 1.0;  ///< share of the estimated wind's variance along its main line
};

/// @param residual force residual in columns 0 to 2 (N×6)
/// @param d_wind derivative of the predicted force by the wind along world x, y, z (N×6 each)
GustTest TestGusts(const ThinnedFlight& flight, const ResidualModel::Wrenches& residual,
                   const std::array<ResidualModel::Wrenches, 3>& d_wind);

/// Wind in the world at each sample [m/s], by a Kalman filter that has seen all but the last
/// `ahead` samples before it.
/// @param residual,d_wind as above, without gusts
std::vector<Eigen::Vector3d> PredictGusts(const ThinnedFlight& flight,
                                          const ResidualModel::Wrenches& residual,
                                          const std::array<ResidualModel::Wrenches, 3>& d_wind,
                                          double sigma_m_s, double time_constant_s, int ahead);

}  // namespace odmc
