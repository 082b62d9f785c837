#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <optional>
#include <vector>

#include "odmc/inspection/motion_signals.h"
#include "odmc/model/vehicle.h"

namespace odmc {

/// Means and differences over short windows of flight, one column a window. Streams that are not
/// there have no columns.
struct MotionWindows {
  std::vector<double> t_s;                       ///< middles
  std::vector<Eigen::Quaterniond> q_WS, q0, q1;  ///< in the middle, at both ends
  Eigen::Matrix3Xd displacement_m_s;             ///< of the position, over the window's length
  Eigen::Matrix3Xd acceleration_W;               ///< second difference of the position
  Eigen::Matrix3Xd velocity, rates, gyro, accelerometer;  ///< means
  Eigen::MatrixXd rotors;                                 ///< means of the squares

  int size() const { return static_cast<int>(t_s.size()); }
};

constexpr double kWindow_s = 0.1;    ///< means; accelerations are over three of them
constexpr int kWindowsPerBlock = 5;  ///< half a second of flight

/// Those of the windows in which the attitude turns slower than this [rad/s].
MotionWindows CalmOnes(const MotionWindows& windows, double most_rad_s);

/// Windows that every stream covers, one after the other.
MotionWindows WindowsOf(const MotionSignals& signals, const std::vector<bool>& flight);

}  // namespace odmc
