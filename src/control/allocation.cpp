#include "odmc/control/allocation.h"

#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

namespace odmc {
namespace {

constexpr double kYawLever = 0.1;  // drag torque of a rotor over its thrust, in arm lengths

}  // namespace

Allocation::Allocation(const RotorMap& map, double arm_length_m, double min_squared,
                       double max_squared)
    : map_(map), min_squared_(min_squared), max_squared_(max_squared) {
  if (!map_.allFinite()) throw std::invalid_argument("the rotor map is not a number");
  // The torque rows are scaled so that neither rank nor least squares hang on units.
  const Eigen::Vector4d scale(1.0, 1.0 / arm_length_m, 1.0 / arm_length_m,
                              1.0 / (kYawLever * arm_length_m));
  const Eigen::MatrixXd scaled = scale.asDiagonal() * Eigen::MatrixXd(map_);
  const Eigen::CompleteOrthogonalDecomposition<Eigen::MatrixXd> decomposition(scaled);
  if (decomposition.rank() < 4) {
    throw std::invalid_argument(
        "these rotors can't make thrust and all three torques: check their places, spins and "
        "coefficients");
  }
  inverse_ = decomposition.pseudoInverse() * scale.asDiagonal();
  lift_ = inverse_.col(0);
  if (lift_.minCoeff() <= 0.0) {
    throw std::invalid_argument(
        "these rotors can't hover level without one of them pulling down: is the centre of mass "
        "outside the rotors?");
  }
}

Allocation::Interval Allocation::Room(const RotorVector& base) const {
  Interval room = {-std::numeric_limits<double>::infinity(),
                   std::numeric_limits<double>::infinity()};
  for (int j = 0; j < base.size(); ++j) {
    room.low = std::max(room.low, (min_squared_ - base[j]) / lift_[j]);
    room.high = std::min(room.high, (max_squared_ - base[j]) / lift_[j]);
  }
  return room;
}

double Allocation::TiltShare(const RotorVector& thrust, const RotorVector& tilt) const {
  // Every pair of a lower and an upper bound on the change of thrust bounds the share, linearly.
  double share = 1.0;
  for (int j = 0; j < thrust.size(); ++j) {
    for (int l = 0; l < thrust.size(); ++l) {
      const double gap =
          (max_squared_ - thrust[l]) / lift_[l] - (min_squared_ - thrust[j]) / lift_[j];
      const double slope = tilt[l] / lift_[l] - tilt[j] / lift_[j];
      if (slope > 0.0) share = std::min(share, std::max(0.0, gap) / slope);
    }
  }
  return share;
}

double Allocation::YawShare(const RotorVector& base, const RotorVector& yaw) const {
  double share = 1.0;
  for (int j = 0; j < base.size(); ++j) {
    const double room = yaw[j] > 0.0 ? max_squared_ - base[j] : base[j] - min_squared_;
    if (std::abs(yaw[j]) > room) share = std::min(share, std::max(0.0, room) / std::abs(yaw[j]));
  }
  return share;
}

RotorVector Allocation::SquaredSpeeds(const Eigen::Vector4d& wrench,
                                      AllocationReport* report) const {
  const RotorVector thrust = wrench[0] * lift_;
  const RotorVector tilt = inverse_.middleCols<2>(1) * wrench.segment<2>(1);
  const RotorVector yaw = inverse_.col(3) * wrench[3];

  AllocationReport found;
  found.roll_pitch_share = TiltShare(thrust, tilt);
  RotorVector base = thrust + found.roll_pitch_share * tilt;
  const Interval room = Room(base);
  // At the largest share low and high meet, up to rounding.
  found.thrust_change_N = std::min(std::max(0.0, room.low), room.high);
  base += found.thrust_change_N * lift_;
  found.yaw_share = YawShare(base, yaw);
  if (report != nullptr) *report = found;
  return (base + found.yaw_share * yaw).cwiseMax(min_squared_).cwiseMin(max_squared_);
}

}  // namespace odmc
