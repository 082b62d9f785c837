#include "odmc/sensing/twist_frame.h"

#include <algorithm>
#include <cmath>

#include "odmc/text/format.h"

namespace odmc {
namespace {

constexpr double kStretch_s = 0.3;  // long enough that position noise of 1 cm is 5 cm/s
constexpr double kLongestGap_s = 0.25;
// A step of the position so far beyond what the twist makes of it is a jump of the odometry, and no
// motion in either frame.
constexpr double kJump_m = 0.3, kJumpOverTwist = 3.0;
constexpr double kMotion_m_s = 0.3;  // slower stretches say little about either frame
constexpr double kEnoughToDecide_s = 1.0;
constexpr double kEnoughToRefuse_s = 2.0;
// Residuals over the RMS speed: a right frame leaves a few per cent, a wrong one about 1.
constexpr double kFits = 0.4;
constexpr double kClearlyBetter = 0.6;  // best over other
constexpr double kClearMargin = 0.03;

}  // namespace

std::optional<TwistFrame> TwistFrameStated(const std::string& setting) {
  if (setting == "auto") return TwistFrame::kUndecided;
  if (setting == "body") return TwistFrame::kBody;
  if (setting == "world") return TwistFrame::kWorld;
  return std::nullopt;
}

Eigen::Vector3d TwistInWorld(TwistFrame frame, const Eigen::Quaterniond& q_WS,
                             const Eigen::Vector3d& twist_linear) {
  return frame == TwistFrame::kWorld ? twist_linear : Eigen::Vector3d(q_WS * twist_linear);
}

std::string TwistFrameDecision::Describe() const {
  return Format(
      "d(position)/dt differs from the twist by %.3f m/s RMS if it is in the body frame "
      "and by %.3f m/s if in the world, at %.3f m/s RMS speed over %.1f s of motion",
      body_residual_m_s, world_residual_m_s, speed_m_s, moving_s);
}

bool TwistFrameDetector::contradicts_none() const {
  const double worst = std::max(decision_.body_residual_m_s, decision_.world_residual_m_s);
  return decision_.moving_s == 0.0 || worst < kFits * decision_.speed_m_s;
}

void TwistFrameDetector::AddSample(Stamp stamp, const Eigen::Vector3d& p_WS,
                                   const Eigen::Quaterniond& q_WS,
                                   const Eigen::Vector3d& twist_linear) {
  if (decided() || !p_WS.allFinite() || !twist_linear.allFinite()) return;
  const Sample sample{stamp, p_WS, q_WS * twist_linear, twist_linear};
  const double step = last_ ? ToSeconds(stamp - last_->stamp) : -1.0;
  if (step <= 0.0 || step > kLongestGap_s) {
    StartStretch(sample);
    return;
  }
  const double twist_m_s = std::max(twist_linear.norm(), last_->v_if_world.norm());
  if ((p_WS - last_->p).norm() > kJump_m + kJumpOverTwist * twist_m_s * step) {
    StartStretch(sample);
    return;
  }
  body_path_ += 0.5 * step * (last_->v_if_body + sample.v_if_body);
  world_path_ += 0.5 * step * (last_->v_if_world + sample.v_if_world);
  last_ = sample;
  if (ToSeconds(stamp - first_.stamp) >= kStretch_s) CloseStretch();
}

void TwistFrameDetector::StartStretch(const Sample& sample) {
  first_ = sample;
  last_ = sample;
  body_path_.setZero();
  world_path_.setZero();
}

void TwistFrameDetector::CloseStretch() {
  const Sample sample = *last_;
  const double dt = ToSeconds(sample.stamp - first_.stamp);
  const Eigen::Vector3d path = sample.p - first_.p;
  // A twist that moves while the position stands (or the other way round) counts as motion too.
  const double speed = std::max({path.norm(), body_path_.norm(), world_path_.norm()}) / dt;
  if (speed >= kMotion_m_s) {
    body_sum_ += (path - body_path_).squaredNorm() / dt;
    world_sum_ += (path - world_path_).squaredNorm() / dt;
    speed_sum_ += speed * speed * dt;
    decision_.moving_s += dt;
    Decide();
  }
  StartStretch(sample);
}

void TwistFrameDetector::Decide() {
  decision_.body_residual_m_s = std::sqrt(body_sum_ / decision_.moving_s);
  decision_.world_residual_m_s = std::sqrt(world_sum_ / decision_.moving_s);
  decision_.speed_m_s = std::sqrt(speed_sum_ / decision_.moving_s);
  const double body = decision_.body_residual_m_s / decision_.speed_m_s;
  const double world = decision_.world_residual_m_s / decision_.speed_m_s;
  const double best = std::min(body, world), other = std::max(body, world);
  if (decision_.moving_s >= kEnoughToDecide_s && best < kFits && best < kClearlyBetter * other &&
      other - best > kClearMargin) {
    decision_.frame = body < world ? TwistFrame::kBody : TwistFrame::kWorld;
  } else if (decision_.moving_s >= kEnoughToRefuse_s && best >= kFits) {
    decision_.frame = TwistFrame::kNeither;
  }
}

TwistFrame ResolveTwistFrame(TwistFrame verdict, const std::string& frame_id,
                             const std::string& child_frame_id) {
  if (verdict != TwistFrame::kUndecided) return verdict;
  return !child_frame_id.empty() && child_frame_id == frame_id ? TwistFrame::kWorld
                                                               : TwistFrame::kBody;
}

}  // namespace odmc
