#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>

#include "odmc/sensing/samples.h"

namespace odmc {

/// What one interval between two keyframes says about the phase. Forces are over the weight, in B.
struct PhaseEvidence {
  Stamp stamp = 0;  ///< of the interval's end
  double dt = 0.0;  ///< [s]; 0: the first keyframe, or one after a gap
  Eigen::Vector3d p_WS = Eigen::Vector3d::Zero();
  Eigen::Quaterniond q_WS = Eigen::Quaterniond::Identity();
  double speed_m_s = 0.0;
  double rate_rad_s = 0.0;
  bool has_force = false;  ///< the interval has velocities and rotor speeds
  Eigen::Vector3d felt_force = Eigen::Vector3d::Zero();     ///< measured specific force over g
  Eigen::Vector3d missing_force = Eigen::Vector3d::Zero();  ///< of that, what the model lacks
  double thrust_ratio = 0.0;                                ///< the model's thrust
  double thrust_sigma = 0.0;                                ///< of the thrust coefficient, relative
  double velocity_noise_m_s = 0.0;                          ///< of one keyframe's velocity
  double attitude_noise_rad = 0.0;                          ///< of one keyframe's attitude
  double position_noise_m = 0.0;                            ///< of one keyframe's position
};

/// Evidence of a tenth of a second: sums while it is filled, means once Close() was called. Names
/// and units are those of PhaseEvidence.
struct PhaseBlock {
  Stamp from = 0, to = 0;
  double duration_s = 0.0, forced_s = 0.0;  // forced: with velocities and rotor speeds
  int samples = 0;
  Eigen::Vector3d felt = Eigen::Vector3d::Zero(), missing = Eigen::Vector3d::Zero();
  double thrust = 0.0, thrust_sigma = 0.0, velocity_noise = 0.0;
  double attitude_noise = 0.0, position_noise = 0.0;
  double speed = 0.0, rate = 0.0;
  Eigen::Matrix3d R_WS = Eigen::Matrix3d::Zero();
  Eigen::Vector3d p_WS = Eigen::Vector3d::Zero();

  void Add(const PhaseEvidence& e);
  /// Sums to means. Without forces for half of the time, they are zero.
  void Close();
  bool has_force() const { return forced_s >= 0.5 * duration_s; }
};

/// Does the vehicle stand still? By the spread of the newest blocks' means about theirs, beside
/// what white noise would leave.
class Stillness {
 public:
  void Add(const PhaseBlock& block);
  /// Over what a stand shows at most; 1 until half a second was seen.
  double wander() const { return wander_; }
  /// False until half a second was seen.
  bool is_still() const { return wander_ < 1.0; }

 private:
  std::array<PhaseBlock, 5> recent_;
  int num_ = 0, next_ = 0;
  double wander_ = 1.0;
};

}  // namespace odmc
