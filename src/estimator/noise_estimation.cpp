#include "odmc/estimator/noise_estimation.h"

#include <algorithm>
#include <cmath>

#include "odmc/math/so3.h"
#include "odmc/math/statistics.h"
#include "odmc/sensing/push_newest.h"

namespace odmc {
namespace {

constexpr double kBlock_s = 0.1;    // block over which residuals are averaged
constexpr double kMemory_s = 60.0;  // how far back the process noise looks
constexpr double kThrustAxisShape = 2.0;
constexpr double kYawAxisShape = 2.0;
// Until residuals mean something the levels start high; that fades quickly, because inertia is
// corrected for rotor noise by its share in the whole (DynamicsFactor).
constexpr double kStartLevel = 100.0;
constexpr double kStartCounts_s = 0.25;  // flight time the start level counts for
constexpr double kStartFades_s = 0.5;
constexpr double kStep = 1.2;   // of a level before the one in use follows: a tenth in sigma
constexpr int kLookEvery = 25;  // samples between two medians
constexpr int kEnoughDifferences = 20, kMostDifferences = 200;

struct Range {
  double low, high;
};
// What any odometry can be: outside these the difference measures motion or a quantisation step.
constexpr Range kPosition{2e-4, 0.5}, kAttitude{2e-4, 0.1}, kVelocity{2e-3, 0.5}, kRate{2e-3, 0.3};

double Choose(double configured, const DifferenceNoise& measured, Range range) {
  if (configured > 0.0) return configured;
  return std::clamp(measured.Sigma(), range.low, range.high);
}

}  // namespace

void DifferenceNoise::Add(double time_s, const Channels& sample) {
  if (times_.size() >= 2) {
    const double dt = times_.back() - times_[times_.size() - 2];
    const double now = time_s - times_.back();
    if (now < 0.5 * dt || now > 1.5 * dt) {
      times_.clear();
      run_.clear();
    }
  }
  times_.push_back(time_s);
  run_.push_back(sample);
  if (run_.size() < 4) return;
  differences_.Append() = run_[3] - 3.0 * run_[2] + 3.0 * run_[1] - run_[0];
  run_.pop_front();
  times_.pop_front();
  if (static_cast<int>(differences_.size()) > kMostDifferences) differences_.pop_front();
  ++since_look_;
}

double DifferenceNoise::Sigma() const {
  if (static_cast<int>(differences_.size()) < kEnoughDifferences) return 0.0;
  if (since_look_ < kLookEvery) return sigma_;
  since_look_ = 0;
  all_.clear();
  for (const Channels& d : differences_) all_.insert(all_.end(), d.begin(), d.end());
  sigma_ = in_steps_ ? HuberSigma(all_) : RobustSigmaInPlace(&all_);
  sigma_ /= std::sqrt(20.0);  // 1 + 9 + 9 + 1
  return sigma_;
}

OdometryNoiseEstimator::OdometryNoiseEstimator(const OdometryNoise& configured)
    : configured_(configured) {}

void OdometryNoiseEstimator::Add(const OdometrySample& sample) {
  const double t = ToSeconds(sample.stamp);
  if (!has_reference_ || sample.q_WS.angularDistance(reference_) > 0.5) {
    // Rotation vectors are differenced about a nearby reference, where they are nearly linear.
    reference_ = sample.q_WS;
    has_reference_ = true;
    attitude_.Add(-1.0, Eigen::Vector3d::Zero());  // an impossible spacing starts a new run
  }
  position_.Add(t, sample.p_WS);
  attitude_.Add(t, Log(reference_.conjugate() * sample.q_WS));
  if (sample.v_WS) velocity_.Add(t, *sample.v_WS);
  if (sample.w_WS_S) rate_.Add(t, *sample.w_WS_S);
}

OdometryNoise OdometryNoiseEstimator::Noise() const {
  OdometryNoise noise;
  noise.position_m = Choose(configured_.position_m, position_, kPosition);
  noise.attitude_rad = Choose(configured_.attitude_rad, attitude_, kAttitude);
  noise.velocity_m_s = Choose(configured_.velocity_m_s, velocity_, kVelocity);
  noise.rate_rad_s = Choose(configured_.rate_rad_s, rate_, kRate);
  return noise;
}

void StreamNoise::Add(const OdometrySample& sample) {
  if (sample.p_WS.allFinite() && sample.q_WS.coeffs().allFinite()) {
    PushNewest(sample, &waiting_odometry_);
  }
}

void StreamNoise::Add(const RotorSample& sample) {
  if (sample.speed.allFinite()) PushNewest(sample, &waiting_rotors_);
}

void StreamNoise::AdvanceTo(Stamp stamp) {
  for (; !waiting_odometry_.empty() && waiting_odometry_.front().stamp <= stamp;
       waiting_odometry_.pop_front()) {
    odometry_.Add(waiting_odometry_.front());
  }
  for (; !waiting_rotors_.empty() && waiting_rotors_.front().stamp <= stamp;
       waiting_rotors_.pop_front()) {
    rotors_.Add(ToSeconds(waiting_rotors_.front().stamp), waiting_rotors_.front().speed);
  }
}

void StreamNoise::Restart() {
  waiting_odometry_.clear();
  waiting_rotors_.clear();
}

ProcessNoiseEstimator::ProcessNoiseEstimator(double weight_N, double arm_m, double floor_scale) {
  // 0.05 N and 1 mN m as means over 10 ms for a vehicle of 7.36 N and 0.145 m (model.md section 9).
  const double force = floor_scale * 6.8e-4 * weight_N;
  const double torque = floor_scale * 9.4e-5 * weight_N * arm_m;
  // Thrust carries most of what a model lacks, and yaw is what rotors accelerating spoil.
  floor_ << force, force, kThrustAxisShape * force, torque, torque, kYawAxisShape * torque;
  in_use_ = Seen();
}

ProcessNoiseEstimator::Levels ProcessNoiseEstimator::Seen() const {
  return {std::max(1.0, WithStart(force_level_)), std::max(1.0, WithStart(torque_level_))};
}

void ProcessNoiseEstimator::Add(const IntervalResidual& residual, bool with_torque) {
  const double dt = residual.dt;
  sum_.head<3>() += dt * residual.force_N;
  sum_.tail<3>() += dt * residual.torque_Nm;
  rotor_variance_.head<3>() += (dt * residual.rotor_force_N).cwiseAbs2();
  rotor_variance_.tail<3>() += (dt * residual.rotor_torque_Nm).cwiseAbs2();
  block_s_ += dt;
  if (block_s_ < kBlock_s) return;
  flown_s_ += block_s_;
  seen_s_ = std::min(kMemory_s, seen_s_ + block_s_);
  const double gain = block_s_ / seen_s_;
  // Densities of this block in units of the floor, without what rotor noise put there; one wild
  // block counts as five sigma.
  const Vector6d level =
      (sum_.cwiseAbs2() - rotor_variance_).cwiseQuotient(floor_.cwiseAbs2()) / block_s_;
  const auto follow = [&](double seen, double* average) {
    const double most = 25.0 * std::max(1.0, WithStart(*average));
    *average += gain * (std::min(seen, most) - *average);
  };
  follow(level.head<3>().mean(), &force_level_);
  if (with_torque) follow(level.tail<3>().mean(), &torque_level_);
  sum_.setZero();
  rotor_variance_.setZero();
  block_s_ = 0.0;
}

std::optional<ProcessNoiseEstimator::Change> ProcessNoiseEstimator::Step() {
  if (seen_s_ == 0.0) return std::nullopt;
  const Levels seen = Seen();
  const Change change{in_use_.force / seen.force, in_use_.torque / seen.torque};
  // What three axes of so many blocks may be off by chance is no step.
  const double chance = std::sqrt(2.0 * kBlock_s / (3.0 * seen_s_));
  const double least = std::max(std::log(kStep), 2.0 * chance);
  const auto is_step = [&](double ratio) { return std::abs(std::log(ratio)) > least; };
  if (!is_step(change.force) && !is_step(change.torque)) return std::nullopt;
  in_use_ = seen;
  return change;
}

double ProcessNoiseEstimator::WithStart(double level) const {
  const double start_s = kStartCounts_s * std::exp(-flown_s_ / kStartFades_s);
  return (start_s * kStartLevel + seen_s_ * level) / (start_s + seen_s_);
}

Eigen::Vector3d ProcessNoiseEstimator::ForceSigma(double dt) const {
  return std::sqrt(in_use_.force / dt) * floor_.head<3>();
}

Eigen::Vector3d ProcessNoiseEstimator::TorqueSigma(double dt) const {
  return std::sqrt(in_use_.torque / dt) * floor_.tail<3>();
}

}  // namespace odmc
