#pragma once

#include <Eigen/Core>
#include <array>
#include <string>
#include <vector>

namespace odmc {

/// Flat output of a quadrotor at one instant: where Bo shall be, and where it shall look.
struct FlatReference {
  Eigen::Vector3d p_WB = Eigen::Vector3d::Zero();  ///< [m]
  Eigen::Vector3d v_WB = Eigen::Vector3d::Zero();  ///< [m/s]
  Eigen::Vector3d a_WB = Eigen::Vector3d::Zero();  ///< [m/s²]
  Eigen::Vector3d j_WB = Eigen::Vector3d::Zero();  ///< [m/s³]
  Eigen::Vector3d s_WB = Eigen::Vector3d::Zero();  ///< [m/s⁴]
  double yaw = 0.0;     ///< turn about W z before the shortest tilt [rad]
  double d_yaw = 0.0;   ///< [rad/s]
  double dd_yaw = 0.0;  ///< [rad/s²]
};

/// One sinusoid A sin(w t + phase) of a trajectory.
struct Sinusoid {
  double amplitude;  ///< [m] or [rad]
  double frequency;  ///< [rad/s]
  double phase;      ///< [rad]
};

/// A named reference flight: sums of sinusoids on x, y, z and yaw, entered from hover. Time along
/// the path starts at rest and reaches full rate after ramp_s(), so position to snap are smooth.
/// Vehicles of any size fly the same accelerations (thrust to weight below 3).
class Trajectory {
 public:
  /// hover, octo, circle, vertical, yaw, aggressive.
  static const std::vector<std::string>& Names();

  /// @param name one of Names(), else std::invalid_argument with a sentence that lists them
  /// @param ground_s time to stand at z = 0 before climbing to the start; 0 starts in hover [s]
  explicit Trajectory(const std::string& name, double ground_s = 0.0);

  /// @param time_s since the start of the flight [s]
  FlatReference At(double time_s) const;

  const std::string& name() const { return name_; }
  /// Time at which the vehicle hovers at the start of the path [s].
  double start_s() const { return start_s_; }
  double ramp_s() const;

 private:
  std::string name_;
  double ground_s_;
  double start_s_;
  double centre_z_;
  std::array<std::vector<Sinusoid>, 4> axes_;  // x, y, z, yaw
};

}  // namespace odmc
