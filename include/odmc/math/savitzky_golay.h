#pragma once

#include <Eigen/Core>
#include <vector>

namespace odmc {

/// Value and derivatives of a signal at one sample, from a cubic fitted to the samples around it.
struct LocalPolynomial {
  Eigen::VectorXd value;   ///< channels×1
  Eigen::VectorXd first;   ///< per second
  Eigen::VectorXd second;  ///< per second squared
};

/// Savitzky-Golay filter of order 3 over an odd number of samples. Fits the cubic on the samples'
/// own stamps, so it equals the textbook filter where they are even and stays right where they
/// jitter.
class SavitzkyGolay {
 public:
  static constexpr int kOrder = 3;

  /// @param count number of samples in the window, odd, >= 5
  explicit SavitzkyGolay(int count);

  /// Odd number of samples nearest to `width_s` at the spacing `step_s`; at least 5.
  static int NearestOddCount(double width_s, double step_s);

  int count() const { return count_; }

  /// Fit at sample `centre` of `samples` (channels×n, one column a sample) at `times_s` (n).
  /// @pre count()/2 <= centre < n - count()/2
  LocalPolynomial At(const std::vector<double>& times_s, const Eigen::MatrixXd& samples,
                     int centre) const;

 private:
  int count_;
};

}  // namespace odmc
