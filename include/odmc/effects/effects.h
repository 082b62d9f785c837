#pragma once

#include <memory>
#include <string>
#include <vector>

#include "odmc/model/effect.h"

/// \file
/// The catalogue: every effect of this package by name, with its constructor. To add one, write
/// src/effects/NAME.cpp (and name it in CMakeLists.txt) and add its line here; estimator,
/// simulator, evaluation, attribution, test flights, reports and `list_effects` then know it. Code
/// outside this package calls EffectRegistry::Extend().

#define ODMC_EFFECTS(X)                               \
  X(thrust, MakeThrust)                               \
  X(rotor_torque, MakeRotorTorque)                    \
  X(drag, MakeDrag)                                   \
  X(viscous_torque, MakeViscousTorque)                \
  X(hvt, MakeHvt)                                     \
  X(centre_of_gravity, MakeCentreOfGravity)           \
  X(inertia, MakeInertia)                             \
  X(gravity, MakeGravity)                             \
  X(odometry_extrinsics, MakeOdometryExtrinsics)      \
  X(imu_extrinsics, MakeImuExtrinsics)                \
  X(rotor_drag, MakeRotorDrag)                        \
  X(quadratic_drag, MakeQuadraticDrag)                \
  X(axial_inflow, MakeAxialInflow)                    \
  X(rotor_hvt, MakeRotorHvt)                          \
  X(anisotropic_hvt, MakeAnisotropicHvt)              \
  X(hub_moment, MakeHubMoment)                        \
  X(rotor_gyroscopic, MakeRotorGyroscopic)            \
  X(rotor_reaction, MakeRotorReaction)                \
  X(rotor_asymmetry, MakeRotorAsymmetry)              \
  X(pressure_centre, MakePressureCentre)              \
  X(rotor_tilt, MakeRotorTilt)                        \
  X(wind, MakeWind)                                   \
  X(gust, MakeGust)                                   \
  X(thrust_drift, MakeThrustDrift)                    \
  X(ground_effect, MakeGroundEffect)                  \
  X(products_of_inertia, MakeProductsOfInertia)       \
  X(mass_change, MakeMassChange)                      \
  X(rotor_delay, MakeRotorDelay)                      \
  X(suspended_load, MakeSuspendedLoad)                \
  X(anisotropic_hub_moment, MakeAnisotropicHubMoment) \
  X(skewed_inflow, MakeSkewedInflow)                  \
  X(thrust_lean, MakeThrustLean)                      \
  X(rotor_level, MakeRotorLevel)                      \
  X(inflow_drag, MakeInflowDrag)                      \
  X(saturating_lift, MakeSaturatingLift)              \
  X(vortex_ring, MakeVortexRing)                      \
  X(directional_lift, MakeDirectionalLift)            \
  X(vertical_drag, MakeVerticalDrag)                  \
  X(wake_moment, MakeWakeMoment)                      \
  X(body_moment, MakeBodyMoment)                      \
  X(rotor_interference, MakeRotorInterference)        \
  X(blade_element, MakeBladeElement)

namespace odmc {

#define ODMC_DECLARE_EFFECT(name, make) std::unique_ptr<Effect> make(const Vehicle& vehicle);
ODMC_EFFECTS(ODMC_DECLARE_EFFECT)
#undef ODMC_DECLARE_EFFECT

/// The paper's model: what a vehicle file without a list of effects gets.
const std::vector<std::string>& DefaultEffects();

}  // namespace odmc
