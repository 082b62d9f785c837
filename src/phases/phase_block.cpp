#include "odmc/phases/phase_block.h"

#include <algorithm>
#include <cmath>

namespace odmc {
namespace {

// A vehicle in the air moves: over half a second the attitude wanders by more than 1 mrad and the
// position by more than 3 mm in every recording (99 % of stretches of nine vehicles), on the ground
// by less than half of that. White noise of the sensors is allowed for.
constexpr double kStillAngle_rad = 1.0e-3, kStillWay_m = 3.0e-3, kStillNoise = 2.5;

}  // namespace

void PhaseBlock::Add(const PhaseEvidence& e) {
  if (samples == 0) from = e.stamp - static_cast<Stamp>(1e9 * e.dt);
  to = e.stamp;
  ++samples;
  duration_s += e.dt;
  R_WS += e.q_WS.toRotationMatrix();
  p_WS += e.p_WS;
  speed += e.speed_m_s;
  rate += e.rate_rad_s;
  attitude_noise = e.attitude_noise_rad;
  position_noise = e.position_noise_m;
  velocity_noise = e.velocity_noise_m_s;
  thrust_sigma = e.thrust_sigma;
  if (!e.has_force) return;
  forced_s += e.dt;
  felt += e.dt * e.felt_force;
  missing += e.dt * e.missing_force;
  thrust += e.dt * e.thrust_ratio;
}

void PhaseBlock::Close() {
  const double n = samples;
  R_WS /= n;
  p_WS /= n;
  speed /= n;
  rate /= n;
  if (!has_force()) {
    felt = missing = Eigen::Vector3d::Zero();
    thrust = 0.0;
    return;
  }
  felt /= forced_s;
  missing /= forced_s;
  thrust /= forced_s;
}

void Stillness::Add(const PhaseBlock& block) {
  const int size = static_cast<int>(recent_.size());
  recent_[static_cast<size_t>(next_)] = block;
  next_ = (next_ + 1) % size;
  num_ = std::min(num_ + 1, size);
  wander_ = 1.0;
  if (num_ < size) return;
  Eigen::Matrix3d R = Eigen::Matrix3d::Zero();
  Eigen::Vector3d p = Eigen::Vector3d::Zero();
  for (const PhaseBlock& b : recent_) R += b.R_WS / num_, p += b.p_WS / num_;
  double turn = 0.0, way = 0.0;
  for (const PhaseBlock& b : recent_) {
    turn += 0.5 * (b.R_WS - R).squaredNorm() / num_;
    way += (b.p_WS - p).squaredNorm() / num_;
  }
  const double share = kStillNoise * std::sqrt(3.0 / std::max(block.samples, 1));
  wander_ = std::max(std::sqrt(turn) / std::max(kStillAngle_rad, share * block.attitude_noise),
                     std::sqrt(way) / std::max(kStillWay_m, share * block.position_noise));
}

}  // namespace odmc
