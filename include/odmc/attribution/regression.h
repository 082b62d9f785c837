#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

namespace odmc {

/// Force and torque channels of a residual wrench.
constexpr int kNumChannels = 6;

/// Derivatives of each channel (N×k).
using WrenchColumns = std::array<Eigen::MatrixXd, kNumChannels>;

/// A residual wrench with its derivatives by the parameters that may explain it, at equally spaced
/// samples. Rows are samples; `next[i]` is true if sample i follows sample i-1 without a gap.
struct WrenchRegression {
  Eigen::Matrix<double, Eigen::Dynamic, kNumChannels> y;  ///< N×6 [N, N m]
  WrenchColumns columns;                                  ///< N×n each
  Eigen::VectorXd prior_offset;                           ///< n: prior minus present value
  Eigen::VectorXd prior_sigma;                            ///< n
  std::vector<bool> next;                                 ///< N
  std::vector<int> block;                                 ///< N: block of time
  std::vector<bool> used;                                 ///< N: false for blocks held out
  int num_channels = kNumChannels;                        ///< 3 without torque
};

/// A regression fitted by least squares with serially correlated noise.
struct WrenchFit {
  Eigen::VectorXd step;        ///< n: change of the parameters
  Eigen::MatrixXd covariance;  ///< n×n
  /// Samples in use, the fold of each (folds are blocks of time), and the variance of its
  /// prediction by a fit to the other folds from that fit's own uncertainty, in units of the
  /// innovation's (samples in use × channels).
  std::vector<int> rows, fold;
  Eigen::MatrixXd leverage;
  /// For each fold the residual (N×6) of a fit to the others.
  std::vector<Eigen::Matrix<double, Eigen::Dynamic, kNumChannels>> unseen_residual;
  /// Mean square of the samples in use, each block predicted by a plain fit (white noise of each
  /// channel's size) to the others: what the estimator would do.
  std::array<double, kNumChannels> plain_mean_square{};
  /// The same sums over the blocks of each fold, not yet divided by the number of samples.
  std::vector<std::array<double, kNumChannels>> plain_fold_squares;
  Eigen::VectorXd plain_step;                                          ///< n: of the plain fit
  std::array<double, kNumChannels> plain_variance{};                   ///< its noise
  Eigen::Matrix<double, Eigen::Dynamic, kNumChannels> plain_residual;  ///< N×6
  Eigen::Matrix<double, Eigen::Dynamic, kNumChannels> residual;        ///< N×6, all samples
  std::array<double, kNumChannels> innovation_variance{};
  std::array<Eigen::VectorXd, kNumChannels> noise_coefficients;  ///< of the autoregression
};

/// A gain of log-likelihood, and its standard error as the samples' contributions tell it (Vuong,
/// Likelihood ratio tests for model selection and non-nested hypotheses, 1989).
struct Gain {
  double nats = 0.0, sigma = 0.0;
};

/// Gain of a fit over another of the same flight in log-likelihood, each block of time predicted by
/// fits to the others. Both are seen through the noise that `fit` leaves: the noise of `base` has
/// taken in what `fit` explains, and an inertia that is biased by what is missing damps the noise
/// that rotor speeds bring. Samples that either could only extrapolate to (leverage above 1) do not
/// count: where a few transients alone tell parameters apart, leaving them out says nothing about
/// the model.
Gain CrossValidatedGain(const WrenchFit& base, const WrenchFit& fit);

/// True if a channel's plain mean square is larger in `fit` by more than two standard errors, as
/// the folds tell it: not because of a single stretch of time.
bool IsWorseThroughout(const WrenchFit& base, const WrenchFit& fit, int channel);

/// Quick look at candidates for a regression: how much likelihood columns would gain on top of it,
/// with the noise of its own fit and without refitting that.
class QuickGain {
 public:
  /// @param fit of `base`
  /// @param serial with the serial correlation of the fit's noise, which has taken in what is
  ///   missing; otherwise as if it were white
  QuickGain(const WrenchRegression& base, const WrenchFit& fit, bool serial = true);

  /// Gain of these columns (N×k each channel) in nats, at most.
  double Of(const WrenchColumns& columns) const;

 private:
  Eigen::MatrixXd Whitened(const WrenchColumns& columns) const;

  int num_channels_;
  std::vector<int> rows_;
  std::array<Eigen::VectorXd, kNumChannels> coefficients_;
  std::array<double, kNumChannels> sigma_{};
  Eigen::MatrixXd Q_;  // of the base's columns
  Eigen::VectorXd rest_;
};

/// Fits with noise that is autoregressive in each channel (order 8 at 25 Hz covers the filter's
/// 0.1 s and more), its coefficients from the fit's own residual, iterated.
/// @pre y and columns have the same number of rows, at least 50 in use
WrenchFit FitWrench(const WrenchRegression& regression);

}  // namespace odmc
