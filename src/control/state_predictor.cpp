#include "odmc/control/state_predictor.h"

#include <algorithm>
#include <cmath>

#include "odmc/math/so3.h"

namespace odmc {
namespace {

constexpr double kMemory_s = 1.0;  // of inertial samples: the longest delay of odometry bridged

}  // namespace

void StatePredictor::Add(const InertialSample& sample) {
  if (!inertial_.empty() && sample.stamp <= inertial_.back().stamp) return;
  inertial_.push_back(sample);
  while (ToSeconds(sample.stamp - inertial_.front().stamp) > kMemory_s) inertial_.pop_front();
}

BodyState StatePredictor::Moved(const BodyState& state, const InertialSample& sample, double dt,
                                const Eigen::Vector3d& g_W) {
  BodyState moved = state;
  const Eigen::Quaterniond q_middle = state.q_WB * Exp(0.5 * dt * sample.w_WB_B);
  const Eigen::Vector3d a_WB = q_middle * sample.specific_force_B + g_W;
  moved.p_WB += dt * state.v_WB + 0.5 * dt * dt * a_WB;
  moved.v_WB += dt * a_WB;
  moved.q_WB = (state.q_WB * Exp(dt * sample.w_WB_B)).normalized();
  moved.w_WB_B = sample.w_WB_B;
  return moved;
}

BodyState StatePredictor::Carried(BodyState state, Stamp until, const Eigen::Vector3d& g_W) const {
  const auto is_later = [](Stamp stamp, const InertialSample& s) { return stamp < s.stamp; };
  auto next = std::upper_bound(inertial_.begin(), inertial_.end(), state.stamp, is_later);
  Stamp at = state.stamp;
  for (; next != inertial_.end() && at < until; ++next) {
    // A sample stands for the time that ends at its stamp.
    const Stamp end = std::min(next->stamp, until);
    state = Moved(state, *next, ToSeconds(end - at), g_W);
    at = end;
  }
  if (at < until) {
    // Without a sensor: straight on, turning as before.
    const InertialSample held =
        inertial_.empty() ? InertialSample{at, state.w_WB_B, state.q_WB.conjugate() * -g_W}
                          : inertial_.back();
    state = Moved(state, held, std::min(ToSeconds(until - at), kHold_s), g_W);
  }
  state.stamp = until;
  return state;
}

bool StatePredictor::Correct(const BodyState& measured, const Eigen::Vector3d& g_W) {
  if (!anchor_ || inertial_.empty()) {
    anchor_ = measured;
    return true;
  }
  if (measured.stamp <= anchor_->stamp) return true;
  const double dt = ToSeconds(measured.stamp - anchor_->stamp);
  BodyState state = Carried(*anchor_, measured.stamp, g_W);
  const bool is_near = (measured.p_WB - state.p_WB).norm() <= kJump_m;  // not if it is no number
  if (dt > kMemory_s || !is_near) {
    anchor_ = measured;
    return false;
  }
  const double share = 1.0 - std::exp(-dt / correction_s_);
  state.p_WB += share * (measured.p_WB - state.p_WB);
  state.v_WB += share * (measured.v_WB - state.v_WB);
  state.q_WB = (state.q_WB * Exp(share * Log(state.q_WB.conjugate() * measured.q_WB))).normalized();
  anchor_ = state;
  return true;
}

std::optional<BodyState> StatePredictor::At(Stamp now, const Eigen::Vector3d& g_W) const {
  if (!anchor_) return std::nullopt;
  return Carried(*anchor_, std::max(now, anchor_->stamp), g_W);
}

void StatePredictor::Reset() {
  inertial_.clear();
  anchor_.reset();
}

}  // namespace odmc
