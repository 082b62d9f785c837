#pragma once

#include <Eigen/Core>

namespace odmc {

/// Largest number of rotors a vehicle may have; rotor vectors never allocate.
constexpr int kMaxRotors = 8;

/// One value per rotor, in the order of the vehicle file.
using RotorVector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxRotors, 1>;

}  // namespace odmc
