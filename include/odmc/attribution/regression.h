#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

namespace odmc {

/// Force and torque channels of a residual wrench.
constexpr int kNumChannels = 6;

/// A residual wrench with its derivatives by the parameters that may explain it, at equally spaced
/// samples. Rows are samples; `next[i]` is true if sample i follows sample i-1 without a gap.
struct WrenchRegression {
  Eigen::Matrix<double, Eigen::Dynamic, kNumChannels> y;  ///< N×6 [N, N m]
  std::array<Eigen::MatrixXd, kNumChannels> columns;      ///< N×n each
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
  /// Innovations of the samples in use, each block of time predicted by a fit to the others, and
  /// the variance of that prediction from the fit's own uncertainty, in units of the innovation's
  /// (rows in use × channels).
  Eigen::MatrixXd predicted_innovation, leverage;
  /// Mean square of the samples in use, each block predicted by a plain fit (white noise of each
  /// channel's size) to the others: what the estimator would do.
  std::array<double, kNumChannels> plain_mean_square{};
  /// The same sums over the blocks of each fold, not yet divided by the number of samples.
  std::vector<std::array<double, kNumChannels>> plain_fold_squares;
  Eigen::VectorXd plain_step;                                          ///< n: of the plain fit
  Eigen::Matrix<double, Eigen::Dynamic, kNumChannels> plain_residual;  ///< N×6
  Eigen::Matrix<double, Eigen::Dynamic, kNumChannels> residual;        ///< N×6, all samples
  std::array<double, kNumChannels> innovation_variance{};
  std::array<Eigen::VectorXd, kNumChannels> noise_coefficients;  ///< of the autoregression
};

/// Gain of one fit over another in log-likelihood, each block of time predicted by fits to the
/// others. Samples that either fit could only extrapolate to (leverage above 1) do not count: where
/// a few transients alone tell parameters apart, leaving them out says nothing about the model.
double CrossValidatedGain(const WrenchFit& base, const WrenchFit& fit);

/// True if a channel's plain mean square is larger in `fit` by more than two standard errors, as
/// the folds tell it: not because of a single stretch of time.
bool IsWorseThroughout(const WrenchFit& base, const WrenchFit& fit, int channel);

/// Quick look at candidates for a regression: how much likelihood columns would gain on top of it,
/// with the noise of its own fit and without refitting that.
class QuickGain {
 public:
  /// @param fit of `base`
  QuickGain(const WrenchRegression& base, const WrenchFit& fit);

  /// Gain of these columns (N×k each channel) in nats, at most.
  double Of(const std::array<Eigen::MatrixXd, kNumChannels>& columns) const;

 private:
  Eigen::MatrixXd Whitened(const std::array<Eigen::MatrixXd, kNumChannels>& columns) const;

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
