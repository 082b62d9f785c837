#pragma once

#include <Eigen/Geometry>

namespace odmc {

/// Smallest rotation that takes the direction of `from` to that of `to` (3×1 each, not zero):
/// Eigen's own, compiled once, as every source that instantiates it compiles a singular value
/// decomposition.
Eigen::Quaterniond RotationBetween(const Eigen::Vector3d& from, const Eigen::Vector3d& to);

}  // namespace odmc
