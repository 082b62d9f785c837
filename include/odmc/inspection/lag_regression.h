#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "odmc/inspection/sampled_signal.h"

namespace odmc {

/// A signal that a stream of unknown lateness should explain:
///
///   y(t) = Bᵀ [moving(t + lag), fixed(t)] + noise,
///
/// on an even grid of times; B is free. The noise may have any colour that an autoregression over
/// 0.12 s describes: the controller answers disturbances some time after them, so what it answered
/// is in the noise's past and its innovations are free of the answer (prediction-error method;
/// Ljung, System Identification, 2nd ed., section 13.4).
struct LagProblem {
  double first_s = 0.0, step_s = 0.01;  ///< of the grid
  double width_s = 0.01;                ///< means of the moving stream are over this
  double memory_s = 0.12;               ///< of the noise; 0: taken as white
  Eigen::MatrixXd y;                    ///< n×c, symmetric about each grid time, as wide
  Eigen::MatrixXd fixed;                ///< n×f, explains as well and does not move
  std::vector<bool> usable;             ///< n
  const SampledSignal* moving = nullptr;
  /// What an onboard observer leaves of the signal (its error over the signal) comes with a lag of
  /// up to this time that is its own, not the stamps'.
  double filter_s = 0.0;
  double reach_s = 0.2;  ///< lags looked at: this far to both sides
};

/// Lateness of a stream. `lag_s` > 0: its stamps are late.
struct StreamLag {
  double lag_s = 0.0;
  /// Sigma from blocks of time: by the scatter of the likelihood's slope over them, or by leaving
  /// out one after the other, whichever is larger.
  double scatter_s = 0.0;
  /// How far the controller's answers to disturbances may pull the lag: the more, the less of the
  /// signal the moving stream explains where rotors lead (3 to 20 Hz). Without a controller 0.
  double pull_s = 0.0;
  /// By how many standard errors (over blocks of time) the best lag explains more than the best one
  /// elsewhere, and than no such stream at all: the smaller of both.
  double contrast = 0.0;
  /// By how many it explains more than no lag, the stamps as they are.
  double over_none = 0.0;
  int blocks = 0;
  Eigen::MatrixXd gain;       ///< k×c: of the moving channels at the best lag
  Eigen::MatrixXd band_gain;  ///< the same of 3 to 20 Hz; empty without memory
  double explained = 0.0;     ///< share of the whitened signal's variance that moving explains
  double band_share = 0.0;    ///< the same of 3 to 20 Hz, median of the blocks
  /// Share of the disagreement without lag that the lag takes away; white noise left aside.
  double cured = 0.0;

  double sigma_s() const;
  /// True if the best lag stands out, see kLeastContrast.
  bool determined() const;
};

/// Three standard errors: a lag that is an accident stands out so far once in 700 recordings.
constexpr double kLeastContrast = 3.0;

/// Lag by generalised least squares with the noise's colour and its size in each block of time
/// estimated beside it; coarse steps over the reach, then parabolas. Empty where there are fewer
/// than 6 blocks to judge by.
std::optional<StreamLag> EstimateLag(const LagProblem& problem);

}  // namespace odmc
