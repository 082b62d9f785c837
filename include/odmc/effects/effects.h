#pragma once

#include <memory>

#include "odmc/model/effect.h"

/// \file
/// Constructors of every effect, one source file each. To add an effect: write src/effects/NAME.cpp,
/// declare its constructor here and register it in src/effects/register.cpp.

namespace odmc {

std::unique_ptr<Effect> MakeThrust(const Vehicle& vehicle);
std::unique_ptr<Effect> MakeRotorTorque(const Vehicle& vehicle);
std::unique_ptr<Effect> MakeDrag(const Vehicle& vehicle);
std::unique_ptr<Effect> MakeViscousTorque(const Vehicle& vehicle);
std::unique_ptr<Effect> MakeHvt(const Vehicle& vehicle);
std::unique_ptr<Effect> MakeCentreOfGravity(const Vehicle& vehicle);
std::unique_ptr<Effect> MakeInertia(const Vehicle& vehicle);
std::unique_ptr<Effect> MakeGravity(const Vehicle& vehicle);
std::unique_ptr<Effect> MakeOdometryExtrinsics(const Vehicle& vehicle);
std::unique_ptr<Effect> MakeImuExtrinsics(const Vehicle& vehicle);

}  // namespace odmc
