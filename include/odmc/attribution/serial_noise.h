#pragma once

#include <Eigen/Core>
#include <vector>

namespace odmc {

/// Noise of one channel of a residual, sampled at equal steps: autoregressive of order 8, which
/// holds the filter's window and vibration, times a factor with one zero near zero frequency: a
/// measurement that was differentiated has no noise there, and no autoregression that a short
/// flight tells falls so steeply. Beside that, or where asked for, a second factor has one pole and
/// one zero near zero frequency. It holds errors that come and go over seconds, as a drifting
/// velocity of odometry has them, beside another sensor's quick noise: no spectrum of a short
/// flight resolves the two.
class SerialNoise {
 public:
  static constexpr int kOrder = 8;

  SerialNoise() = default;
  /// White noise.
  explicit SerialNoise(double variance) : variance_(variance) {}

  /// Fits it to a residual.
  /// @param e N×K: second moments are summed over the columns
  /// @param rows samples that count, in order; each has kOrder predecessors
  /// @param with_derivative true to fit the zero of a derivative and, beside one, the slow factor
  /// @param with_slow true to fit the slow factor in any case
  static SerialNoise Fit(const Eigen::MatrixXd& e, const std::vector<int>& rows, double step_s,
                         bool with_derivative, bool with_slow);

  /// Innovations over their sigma, at `rows`: what of a signal (N) its past does not tell, were it
  /// this noise. Where samples are missing, as much is known of it as is left.
  Eigen::VectorXd Whiten(const Eigen::Ref<const Eigen::VectorXd>& x,
                         const std::vector<int>& rows) const;

 private:
  /// Pole and zero of the factor (1 - zero L) / (1 - pole L), L being the lag by one sample.
  struct Slow {
    double pole = 0.0, zero = 0.0;
  };

  /// Fits the zero of the derivative and the autoregression.
  void FitDerivative(const Eigen::MatrixXd& e, const std::vector<int>& rows, double step_s);
  void FitOrder8(const Eigen::MatrixXd& e, const std::vector<int>& rows, double step_s);
  void FitSlow(const Eigen::MatrixXd& e, const std::vector<int>& rows, double step_s);
  /// Signals (N×K) as they were before they were differentiated, at `rows` and the kOrder samples
  /// before each.
  Eigen::MatrixXd WithoutDerivative(const Eigen::Ref<const Eigen::MatrixXd>& e,
                                    const std::vector<int>& rows) const;
  /// What of these remains after the autoregression (rows × K).
  Eigen::MatrixXd WithoutOrder8(const Eigen::Ref<const Eigen::MatrixXd>& e,
                                const std::vector<int>& rows) const;

  double derivative_zero_ = 0.0;  // of the factor 1 - zero L; 0: not differentiated
  Eigen::Matrix<double, kOrder, 1> coefficients_ = Eigen::Matrix<double, kOrder, 1>::Zero();
  Slow slow_;
  double variance_ = 1.0;
};

}  // namespace odmc
