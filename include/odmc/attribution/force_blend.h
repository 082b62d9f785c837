#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

namespace odmc {

/// Two measurements of a force, or of a torque, as one: at each frequency each counts by how little
/// noise it has. An accelerometer is the better one where the motion's derivative is noisy,
/// odometry where the accelerometer drifts; of a torque a gyro or the odometry's rates, whichever
/// is less noisy. What both feel passes as it is, so effects need no change.
///
/// Frequencies are split into octaves by smoothing splines (the undecimated wavelet transform "a
/// trous"; Shensa, IEEE Trans. Signal Processing 40, 1992), which know of gaps and ends.
class ForceBlend {
 public:
  /// @param follows whether a sample follows the one before it at an equal step
  /// @param counts samples by which the weights are found
  /// @param felt, by_motion what the model leaves of either measurement, by sample
  ForceBlend(const std::vector<bool>& follows, const std::vector<bool>& counts,
             const Eigen::VectorXd& felt, const Eigen::VectorXd& by_motion);

  /// @param felt, by_motion of the same samples: measurements, or their derivatives
  Eigen::VectorXd Blend(const Eigen::VectorXd& felt, const Eigen::VectorXd& by_motion) const;

  static constexpr int kOctaves = 6;  ///< of 25 Hz: down to 0.2 Hz
  /// Weight of the accelerometer, 0 to 1, by octave from the highest on; the last is that of all
  /// that is below, a constant force among it.
  const std::array<double, kOctaves + 1>& felt_weight() const { return felt_weight_; }

 private:
  using Octaves = std::array<Eigen::VectorXd, kOctaves + 1>;

  /// Splits into octaves; they add up to x.
  Octaves OctavesOf(const Eigen::VectorXd& x) const;
  Eigen::VectorXd Smoothed(const Eigen::VectorXd& x, Eigen::Index step) const;

  std::vector<Eigen::Index> run_from_, run_to_;  // of each sample its stretch without gaps: [ , )
  std::array<double, kOctaves + 1> felt_weight_{};
};

}  // namespace odmc
