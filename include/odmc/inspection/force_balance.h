#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "odmc/inspection/motion_signals.h"

namespace odmc {

/// How the rotors carry a vehicle of unknown mass.
struct ForceBalance {
  int windows = 0;              ///< of a tenth of a second of flight
  double k_f_over_mass = 0.0;   ///< thrust per mass and squared speed [m/s² per rad²/s²]
  double relative_sigma = 0.0;  ///< of it, by the scatter of blocks of half a second
  Eigen::Vector3d thrust_axis_S = Eigen::Vector3d::UnitZ();  ///< unit vector
  double lean_rad = 0.0;                                     ///< of the thrust axis from z of S
  double lean_sigma_rad = 0.0;
  double hover_speed_rad_s = 0.0;  ///< of each rotor, when all carry the weight alike
};

/// Regresses the specific force of the pose's own frame S, means over a tenth of a second in flight
/// that turns slower than 3 rad/s, on the sum of the squared rotor speeds:
///
///   R_SW (a_W - g_W) = (k_f/m) n_S sum w² + D v_S + h |v_S|² ,
///
/// with a free 3×3 drag D and a free h (thrust grows with speed), both with wide priors, which
/// matter where a flight does not show them. Blocks of half a second count with Student's weights,
/// so that gusts, touches and hands are outvoted. Neither places, order nor spins of the rotors
/// enter.
/// @param gravity_m_s2 > 0 @param flight from FindFlight()
/// @returns nothing where less than two seconds of such flight are there, or no thrust is seen
std::optional<ForceBalance> BalanceForces(const MotionSignals& signals, double gravity_m_s2,
                                          const std::vector<bool>& flight);

}  // namespace odmc
