#pragma once

#include <memory>

#include "odmc/model/effect.h"

/// \file
/// The catalogue: every effect of this package by name, with its constructor. To add one, write
/// src/effects/NAME.cpp (and name it in CMakeLists.txt) and add its line here; estimator,
/// simulator, evaluation, reports and `list_effects` then know it.

#define ODMC_EFFECTS(X)                          \
  X(thrust, MakeThrust)                          \
  X(rotor_torque, MakeRotorTorque)               \
  X(drag, MakeDrag)                              \
  X(viscous_torque, MakeViscousTorque)           \
  X(hvt, MakeHvt)                                \
  X(centre_of_gravity, MakeCentreOfGravity)      \
  X(inertia, MakeInertia)                        \
  X(gravity, MakeGravity)                        \
  X(odometry_extrinsics, MakeOdometryExtrinsics) \
  X(imu_extrinsics, MakeImuExtrinsics)

namespace odmc {

#define ODMC_DECLARE_EFFECT(name, make) std::unique_ptr<Effect> make(const Vehicle& vehicle);
ODMC_EFFECTS(ODMC_DECLARE_EFFECT)
#undef ODMC_DECLARE_EFFECT

}  // namespace odmc
