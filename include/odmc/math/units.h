#pragma once

#include <cmath>

namespace odmc {

// What others count in, in SI units.
constexpr double kDegree = M_PI / 180.0;           ///< rad
constexpr double kRpm = M_PI / 30.0;               ///< rad/s
constexpr double kStandardGravity_m_s2 = 9.80665;  ///< "g" of an accelerometer, whatever the place

}  // namespace odmc
