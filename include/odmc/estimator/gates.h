#pragma once

#include <Eigen/Core>
#include <array>

#include "odmc/model/dynamic_model.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// Thresholds of GroundGate.
struct GroundGateOptions {
  double take_off_height_m = 0.10;   ///< rise above the stand that counts as flying
  double take_off_speed_m_s = 0.5;   ///< speed that counts as flying, with thrust
  double landed_thrust_ratio = 0.4;  ///< thrust over weight below which a slow vehicle stands
  double landed_speed_m_s = 0.3;
  double confirm_s = 0.2;  ///< how long the signs of a landing must last
  /// Height above the last stand below which flight teaches nothing; 0: it always does. A landing
  /// is known for one only once the thrust is gone; until then the ground carries, too.
  double near_ground_m = 0.0;

  template <typename Visitor>
  void Visit(Visitor* v) {
    v->Field("take_off_height_m", &take_off_height_m);
    v->Field("take_off_speed_m_s", &take_off_speed_m_s);
    v->Field("landed_thrust_ratio", &landed_thrust_ratio);
    v->Field("landed_speed_m_s", &landed_speed_m_s);
    v->Field("confirm_s", &confirm_s);
    v->Field("near_ground_m", &near_ground_m);
  }
};

/// Tells flight from standing on the ground, from thrust against weight, height and motion. On the
/// ground the contact force is unknown, so nothing may be learned there.
class GroundGate {
 public:
  explicit GroundGate(const GroundGateOptions& options) : options_(options) {}

  /// @param thrust_ratio collective thrust over weight by the present estimate
  /// @returns true while airborne
  bool Update(Stamp stamp, const Eigen::Vector3d& p_WS, double speed_m_s, double thrust_ratio);

  bool airborne() const { return airborne_; }
  /// True where the height `z` (in W) may still be, or again be, in touch with the ground.
  bool IsNear(double z) const { return stood_ && z - ground_height_ < options_.near_ground_m; }
  void Reset() { *this = GroundGate(options_); }

 private:
  GroundGateOptions options_;
  bool started_ = false, airborne_ = false;
  bool stood_ = false;  // so that the height of the ground is known
  double ground_height_ = 0.0;
  Stamp quiet_since_ = 0;
  bool quiet_ = false;
};

/// Squared partial correlation of angular acceleration and rotor torque, rate and thrust taken out.
/// 0 where they go against each other.
/// @param gram sum of z z^T, z = (acceleration, torque, rate, thrust) in any units
double InertiaRSquared(const Eigen::Matrix4d& gram);

/// Torque of the rotors about the body's origin per thrust coefficient; about z per torque
/// coefficient [rad² m/s², rad²/s²].
Eigen::Vector3d RotorTorqueDirection(const Vehicle& vehicle, const RotorVector& speed_squared);

/// Tells per axis whether the flight shows the inertia at all. Regresses the angular acceleration
/// on the rotor torque (differences over 50 ms, damping and a torque in proportion to thrust taken
/// out): regressed the other way round it gives 1/r² times the inertia, so below r² = 0.5 two
/// honest procedures differ by more than two (closed-loop flight through unsteady air does that:
/// the rotors fight a disturbance, and their torque goes with minus the disturbance instead of the
/// acceleration). The inertia then stays at its prior.
class InertiaGate {
 public:
  explicit InertiaGate(const Vehicle& vehicle, double min_r_squared = 0.5);

  /// One interval of dt seconds with rates before and after [rad/s, body axes] and mean squared
  /// rotor speeds [rad²/s²].
  void Add(double dt, const Eigen::Vector3d& w0, const Eigen::Vector3d& w1,
           const RotorVector& speed_squared);

  /// Starts a new chain of intervals (after a gap).
  void Break();

  bool IsOpen(int axis) const { return open_[axis]; }
  /// Squared partial correlation of angular acceleration and rotor torque so far.
  double RSquared(int axis) const { return InertiaRSquared(gram_[axis]); }

 private:
  void CloseBlock();

  Vehicle vehicle_;
  double min_r_squared_;
  std::array<Eigen::Matrix4d, 3> gram_;  // (acceleration, torque, rate, thrust)
  std::array<bool, 3> open_ = {false, false, false};
  double time_ = 0.0;
  // The block being filled.
  double block_s_ = 0.0;
  Eigen::Vector3d first_w_, last_w_, torque_sum_, rate_sum_;
  double thrust_sum_ = 0.0;
};

}  // namespace odmc
