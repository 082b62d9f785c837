#pragma once

#include <Eigen/Core>
#include <vector>

namespace odmc {

/// Two measurements of one force as one: at each frequency each counts by how little noise it has.
/// An accelerometer is the better one where the motion's derivative is noisy, odometry where the
/// accelerometer drifts. What both feel passes as it is, so effects need no change.
///
/// Frequencies are split into octaves by smoothing splines (the undecimated wavelet transform "a
/// trous"; Shensa, IEEE Trans. Signal Processing 40, 1992), which know of gaps and ends.
class ForceBlend {
 public:
  /// @param follows whether a sample follows the one before it at an equal step
  /// @param counts samples by which the weights are found
  /// @param felt, by_motion N×3: what the model leaves of either measurement
  ForceBlend(std::vector<bool> follows, const std::vector<bool>& counts,
             const Eigen::MatrixX3d& felt, const Eigen::MatrixX3d& by_motion);

  /// @param felt, by_motion N×3 of the same samples: measurements, or their derivatives
  Eigen::MatrixX3d Blend(const Eigen::MatrixX3d& felt, const Eigen::MatrixX3d& by_motion) const;

  /// Weight of the accelerometer, 0 to 1, by octave from the highest on (kOctaves + 1: the last is
  /// all that is below) and axis.
  const Eigen::MatrixX3d& felt_weight() const { return felt_weight_; }

  static constexpr int kOctaves = 6;  // of 25 Hz: down to 0.2 Hz

 private:
  /// Splits into octaves; they add up to x.
  std::vector<Eigen::MatrixX3d> OctavesOf(const Eigen::MatrixX3d& x) const;
  Eigen::MatrixX3d Smoothed(const Eigen::MatrixX3d& x, int step) const;

  std::vector<int> run_from_, run_to_;  // of each sample, its stretch without gaps: [from, to)
  Eigen::MatrixX3d felt_weight_;
};

}  // namespace odmc
