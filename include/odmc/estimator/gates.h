#pragma once

#include <Eigen/Core>
#include <array>

#include "odmc/model/dynamic_model.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// Squared partial correlation of angular acceleration and torque, rate and thrust taken out.
/// 0 where they go against each other.
/// @param gram sum of z z^T, z = (acceleration, torque, rate, thrust) in any units
double InertiaRSquared(const Eigen::Matrix4d& gram);

/// Torque of the rotors about the body's origin per thrust coefficient; about z per torque
/// coefficient [rad² m/s², rad²/s²].
Eigen::Vector3d RotorTorqueDirection(const Vehicle& vehicle, const RotorVector& speed_squared);

/// Tells per axis whether the flight shows the inertia at all. Regresses the angular acceleration
/// on the torque (differences over 50 ms, damping and a torque in proportion to thrust taken out):
/// regressed the other way round it gives 1/r² times the inertia, so below r² = 0.5 two honest
/// procedures differ by more than two (feedback in unsteady air does that: the rotors fight a
/// disturbance, and their torque goes with minus the disturbance instead of the acceleration). The
/// inertia then stays at its prior. The torque is that of the whole model: what the rotors fight
/// and an effect of the model explains is no disturbance.
class InertiaGate {
 public:
  explicit InertiaGate(double min_r_squared = 0.5);

  /// One interval of dt seconds with rates before and after [rad/s, body axes].
  /// @param torque in any unit per axis that stays the same over the flight
  /// @param speed_squared sum of the rotors' squared speeds [rad²/s²]
  void Add(double dt, const Eigen::Vector3d& w0, const Eigen::Vector3d& w1,
           const Eigen::Vector3d& torque, double speed_squared);

  /// Starts a new chain of intervals (after a gap).
  void Break();

  bool IsOpen(int axis) const { return seen_.open[axis]; }
  /// Squared partial correlation of angular acceleration and torque so far.
  double RSquared(int axis) const { return InertiaRSquared(seen_.gram[axis]); }

  /// What the flight has shown.
  struct Statistics {
    /// Of (acceleration, torque, rate, thrust).
    std::array<Eigen::Matrix4d, 3> gram = {Eigen::Matrix4d::Zero(), Eigen::Matrix4d::Zero(),
                                           Eigen::Matrix4d::Zero()};
    std::array<bool, 3> open = {false, false, false};
    double time_s = 0.0;
  };
  const Statistics& statistics() const { return seen_; }
  /// Goes back to what it had seen before; starts a new chain of intervals.
  void Restore(const Statistics& before);

 private:
  void CloseBlock();

  double min_r_squared_;
  Statistics seen_;
  // The block being filled.
  double block_s_ = 0.0;
  Eigen::Vector3d first_w_, last_w_, torque_sum_, rate_sum_;
  double thrust_sum_ = 0.0;
};

}  // namespace odmc
