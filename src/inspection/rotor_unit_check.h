#pragma once

#include <optional>

#include "motion_windows.h"
#include "odmc/text/finding.h"

namespace odmc {

/// RotorUnitFinding() for the coefficient that carries the mass in these windows, wherever the
/// thrust points and however the body turns; empty where rotor speeds are missing.
std::optional<Finding> CheckRotorUnit(const MotionWindows& windows, const Vehicle& vehicle);

}  // namespace odmc
