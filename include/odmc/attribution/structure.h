#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "odmc/attribution/residual.h"
#include "odmc/attribution/spectrum.h"

namespace odmc {

/// What of a force's structure a second measurement shows, too. Accelerometer and pose err each for
/// itself (vibration; slow errors of attitude and velocity), so what both show is a force.
struct SharedStructure {
  double share = 0.0;  ///< covariance of both over the structured variance: 0 noise, near 1 force
  double sigma = 0.0;  ///< by the scatter over blocks of time
};

/// Structure of one channel of the residual.
struct ChannelStructure {
  std::string name, unit;
  double rmse = 0.0;
  WhitenessResult whiteness;
  std::vector<double> autocorrelation;       ///< at lags of 40 ms
  std::map<std::string, double> dependence;  ///< share of variance by a quadratic in each quantity
  std::optional<SharedStructure> shared;     ///< where the force was measured twice
  /// Of a lateral force, its slow structure as an error of roll or pitch of the odometry would make
  /// it: RMS over the weight [rad].
  std::optional<double> lean_rad;
  /// Of the force along z, its slow structure as a thrust coefficient that wanders would make it:
  /// RMS over the weight [1].
  std::optional<double> thrust_wander;
};

/// What is known of a residual besides itself.
struct ResidualContext {
  /// A second measurement of the residual force, see ResidualModel::ForceByMotion(), of any fit
  /// that has the force; no rows where there is none.
  Eigen::MatrixX3d again = Eigen::MatrixX3d(0, 3);
  /// What ChangeBySampling() changes of it; no rows where streams are fast.
  ResidualModel::Wrenches by_sampling = ResidualModel::Wrenches(0, kNumChannels);
};

/// Name of a channel of the wrench, "force_x" to "torque_z". @param channel 0 to 5
const char* ChannelName(int channel);

/// Structure of every channel of a residual.
/// @param vehicle gives the weight
/// @param in_use_only true if its spectrum shall not see the blocks held out
std::vector<ChannelStructure> StructureByChannel(const ThinnedFlight& flight,
                                                 const ResidualModel::Wrenches& residual,
                                                 int num_channels, const ResidualContext& context,
                                                 const Vehicle& vehicle, bool in_use_only = false);

/// Largest share of a structured channel's structured variance (p < whiteness_p) that a fit
/// explains: all of it where noise accounts for what remains (p > noise_p). 1 if no channel is
/// structured.
double ExplainedStructure(const std::vector<ChannelStructure>& before,
                          const std::vector<ChannelStructure>& after, double whiteness_p,
                          double noise_p);

/// Of each channel the one with less structure. What no parameters of a model explain is in the
/// residual of any of its fits; what only one of them leaves is that fit's error.
/// @pre both have the same channels
std::vector<ChannelStructure> LessStructured(std::vector<ChannelStructure> one,
                                             const std::vector<ChannelStructure>& other);

}  // namespace odmc
