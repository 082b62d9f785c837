#pragma once

#include "odmc/model/effect.h"

/// \file
/// What effects at rotor level share.

namespace odmc {

/// Speed at which the rotors carry the vehicle, by the vehicle file's thrust coefficient or its
/// default [rad/s].
double HoverSpeed(const Vehicle& vehicle);

/// Air at sea level, 15 degrees [kg/m³].
constexpr double kAirDensity = 1.225;

/// Area of all rotor discs [m²].
double DiscArea(const Vehicle& vehicle);

/// Squared induced velocity of hover over thrust of one rotor, by momentum theory: 1 / (2 ρ A)
/// [m/kg].
double InflowSquaredPerThrust(const Rotor& rotor);

/// Induced velocity of hover by momentum theory, of the rotor where it is least [m/s]; infinite
/// without a rotor.
double HoverInflow(const Vehicle& vehicle);

/// The trials of an effect of second order in the advance ratio (air speed over tip speed): one
/// where the flight is fast enough to show it, else none. Such effects change thrust by the square
/// of that ratio, or by an inflow ratio near 0.1 times it: at 0.15 by 2 %, which is what a
/// calibrated model without them misses of the weight at 6 m/s (docs/effects.md).
std::vector<EffectTrial> FastTrials(const Vehicle& vehicle, const FlownRange& flown);

/// Air velocity of a hub, u_j = v_AB_B + w × r_j [m/s].
Eigen::Vector3d HubAirVelocity(const FlightState& state, const Rotor& rotor);

/// Adds `force` at the hub; `d_air` is its derivative by the hub's air velocity (3×3).
void AddHubForce(const Rotor& rotor, const Eigen::Vector3d& force, const Eigen::Matrix3d& d_air,
                 Wrench* wrench, WrenchJacobians* J);

/// Adds f_j = -k Ω_j P u_j at every hub, P a projection; the coefficient is parameter `index`.
///                                                 model.md 12.1 and 12.3, Eq. (M28), (M30)
void AddHubDamping(const FlightState& state, const Vehicle& vehicle, double k,
                   const Eigen::Vector3d& projection, int index, Wrench* wrench,
                   WrenchJacobians* J);

/// Adds f_j = ¼ k (u_jx² + u_jy²) e3 at every hub; the coefficient is parameter `index`.
///                                                                  model.md 12.4, Eq. (M31)
void AddHubLift(const FlightState& state, const Vehicle& vehicle, double k, int index,
                Wrench* wrench, WrenchJacobians* J);

/// Adds the couples J_r Σ s_j Ω_j (w × e3) and J_r Σ s_j dΩ_j/dt e3, those asked for; the inertia
/// of one rotor is parameter `index`.               model.md 12.6 and 12.7, Eq. (M34), (M35)
void AddRotorMomentum(const FlightState& state, const Vehicle& vehicle, double inertia, int index,
                      bool gyroscopic, bool reaction, Wrench* wrench, WrenchJacobians* J);

/// A coefficient of a rotor's force by its speed and air velocity [N s²/m per rad]: natural size
/// such that all rotors at hover make the drag a multirotor shows, 0.3 1/s times mass.
ParameterSpec HubDampingSpec(const std::string& name, const std::string& description,
                             const Vehicle& vehicle);
/// A coefficient of lift by squared horizontal air speed [kg/m].
ParameterSpec LiftSpec(const std::string& name, const std::string& description,
                       const Vehicle& vehicle);
/// Wind velocity along one axis of the world [m/s].
ParameterSpec WindSpec(const std::string& axis);
/// Inertia of one rotor about its axis [kg m²].
ParameterSpec RotorInertiaSpec(const Vehicle& vehicle);

}  // namespace odmc
