#include "odmc/ros/sample_intake.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace odmc {
namespace {

constexpr double kSettle_s = 1.0;     // for all streams to show up
constexpr double kHold_s = 60.0;      // of samples at most while standing still
constexpr size_t kMostHeld = 100000;  // a minute of 1 kHz and all else; of faster streams less
constexpr double kLeap_s = 2.0;       // ahead of all streams; more than any of them lags behind
constexpr double kMoved_m = 0.1;      // so far with a twist of zeros: the source has no twist
constexpr double kTurned_rad = 0.1;
constexpr double kHover_s = 3.0;  // of flight that may tell the frame of the twist

enum StreamIndex { kOdometry, kPose, kImu, kRotors, kJoints, kBattery, kCommands };

Stamp StampOf(const InputSample& input) {
  if (const auto* o = std::get_if<OdometryInput>(&input)) return o->sample.stamp;
  if (const auto* i = std::get_if<ImuInput>(&input)) return i->sample.stamp;
  if (const auto* r = std::get_if<RotorInput>(&input)) return r->sample.stamp;
  if (const auto* b = std::get_if<BatterySample>(&input)) return b->stamp;
  return std::get<CommandSample>(input).stamp;
}

/// Of samples with the same stamp: a command acts at the voltage of its stamp and after it.
int Turn(const Sample& sample) {
  if (std::holds_alternative<BatterySample>(sample)) return 0;
  if (std::holds_alternative<CommandSample>(sample)) return 1;
  return std::holds_alternative<OdometrySample>(sample) ? 3 : 2;
}

/// The order in which a recorded flight is fed: rotors and IMU up to an odometry, then it.
bool IsBefore(const Sample& a, const Sample& b) {
  const auto stamp_of = [](const Sample& sample) {
    return std::visit([](const auto& s) { return s.stamp; }, sample);
  };
  const Stamp stamp_a = stamp_of(a), stamp_b = stamp_of(b);
  if (stamp_a != stamp_b) return stamp_a < stamp_b;
  return Turn(a) < Turn(b);
}

}  // namespace

int SampleIntake::StreamOf(const InputSample& input) {
  if (const auto* o = std::get_if<OdometryInput>(&input)) return o->is_pose ? kPose : kOdometry;
  if (std::holds_alternative<ImuInput>(input)) return kImu;
  if (const auto* r = std::get_if<RotorInput>(&input)) return r->from_joints ? kJoints : kRotors;
  return std::holds_alternative<BatterySample>(input) ? kBattery : kCommands;
}

bool SampleIntake::Push(InputSample input) {
  if (phase_ == IntakePhase::kRefused) return true;
  const StampVerdict verdict = CheckClock(StreamOf(input), StampOf(input));
  if (verdict == StampVerdict::kRefused) return true;
  if (verdict == StampVerdict::kBack) {
    held_.clear();
    ready_.clear();
  }
  if (phase_ == IntakePhase::kFlowing) {
    if (const auto* odometry = std::get_if<OdometryInput>(&input)) FollowTwist(*odometry);
    Pass(input);
  } else {
    Observe(input);
    held_.push_back(std::move(input));
    Forget();
    Decide();
  }
  return verdict != StampVerdict::kBack;
}

std::vector<Sample> SampleIntake::Take() {
  std::stable_sort(ready_.begin(), ready_.end(), IsBefore);
  return std::exchange(ready_, {});
}

// ---- The clock ---------------------------------------------------------------------------------

StampVerdict SampleIntake::CheckClock(int stream, Stamp stamp) {
  // Streams reach us at different moments: of those that did not step back yet, some samples of the
  // old time still come.
  if (middle_) {
    // A stream that has shown the new time since may end that, too.
    if ((stream == back_stream_ || first_[stream]) && stamp > *middle_) {
      middle_.reset();
    } else if (stamp > *middle_) {
      ++stale_;
      return StampVerdict::kRefused;
    }
  }
  if (IsLoneLeap(stream, stamp) || IsLoneLate(stream, stamp)) {
    ++leaps_;
    return StampVerdict::kRefused;
  }
  std::optional<Stamp>& last = last_[stream];
  if (last && IsStepBack(*last, stamp)) {
    middle_ = stamp + (*last - stamp) / 2;
    back_stream_ = stream;
    ++resets_;
    first_.fill(std::nullopt);
    last_.fill(std::nullopt);
    leap_.fill(std::nullopt);
    late_.fill(std::nullopt);
    first_odometry_.reset();
    first_[stream] = last_[stream] = stamp;
    return StampVerdict::kBack;
  }
  if (!first_[stream]) first_[stream] = stamp;
  last = std::max(stamp, last.value_or(stamp));
  return StampVerdict::kForward;
}

/// A stamp far ahead of every stream is an error, until the next of its stream goes on from there
/// (after a pause). Taken at its word, it would make a step back of the clock of all that follows.
bool SampleIntake::IsLoneLeap(int stream, Stamp stamp) {
  const std::optional<Stamp> newest = *std::max_element(last_.begin(), last_.end());
  if (!newest || ToSeconds(stamp - *newest) <= kLeap_s) {
    leap_[stream].reset();
    return false;
  }
  const bool goes_on = leap_[stream] && std::abs(ToSeconds(stamp - *leap_[stream])) <= kLeap_s;
  leap_[stream] = goes_on ? std::nullopt : std::optional<Stamp>(stamp);
  return !goes_on;
}

/// A stamp far behind its stream is a late message (of two sources on one topic, one is always),
/// until the next of its stream goes on from there.
bool SampleIntake::IsLoneLate(int stream, Stamp stamp) {
  const std::optional<Stamp>& last = last_[stream];
  if (!last || !IsStepBack(*last, stamp)) {
    late_[stream].reset();
    return false;
  }
  const bool goes_on = late_[stream] && std::abs(ToSeconds(stamp - *late_[stream])) <= kLeap_s;
  late_[stream] = goes_on ? std::nullopt : std::optional<Stamp>(stamp);
  return !goes_on;
}

// ---- Deciding ----------------------------------------------------------------------------------

void SampleIntake::Observe(const InputSample& input) {
  if (const auto* odometry = std::get_if<OdometryInput>(&input)) {
    if (!odometry->is_pose) {
      ObserveOdometry(*odometry);
    } else if (frame_id_.empty()) {
      frame_id_ = odometry->frame_id;
    }
  } else if (const auto* imu = std::get_if<ImuInput>(&input)) {
    if (!imu_frame_id_) imu_frame_id_ = imu->frame_id;
  } else if (const auto* rotors = std::get_if<RotorInput>(&input)) {
    rms_only_ = rms_only_ || (rotors->rms_only && !rotors_.from_commands);
  }
}

void SampleIntake::ObserveOdometry(const OdometryInput& input) {
  const OdometrySample& sample = input.sample;
  if (!first_odometry_) {
    first_odometry_ = sample;
    frame_id_ = input.frame_id;
    child_frame_id_ = input.child_frame_id;
  }
  moved_m_ = std::max(moved_m_, (sample.p_WS - first_odometry_->p_WS).norm());
  if (moved_m_ > kMoved_m && !moves_since_) moves_since_ = sample.stamp;
  turned_rad_ = std::max(turned_rad_, sample.q_WS.angularDistance(first_odometry_->q_WS));
  saw_linear_ = saw_linear_ || input.linear;
  saw_angular_ = saw_angular_ || sample.w_WS_S;
  if (input.linear) {
    has_nonzero_linear_ = has_nonzero_linear_ || !input.linear->isZero(0.0);
    detector_.AddSample(sample.stamp, sample.p_WS, sample.q_WS, *input.linear);
  }
  if (sample.w_WS_S) has_nonzero_angular_ = has_nonzero_angular_ || !sample.w_WS_S->isZero(0.0);
}

void SampleIntake::Decide() {
  if (decided_) return;
  const auto seen_for = [this](int stream) {
    return first_[stream] ? ToSeconds(*last_[stream] - *first_[stream]) : -1.0;
  };
  const double poses_s = std::max(seen_for(kOdometry), seen_for(kPose));
  const double rotors_s =
      rotors_.from_commands ? seen_for(kCommands) : std::max(seen_for(kRotors), seen_for(kJoints));
  if (poses_s < kSettle_s || rotors_s < kSettle_s) return;
  if (rotors_.needs_voltage && !first_[kBattery]) return;
  use_pose_ = !first_[kOdometry];
  use_joints_ = !first_[kRotors];
  if (!use_pose_ && !TwistIsKnown()) return;
  decided_ = true;
  // A child frame that names the pose's own frame declares a twist in the world, not a sensor.
  if (child_frame_id_ != frame_id_) sensor_frame_id_ = child_frame_id_;
}

bool SampleIntake::TwistIsKnown() {
  const bool linear_known = !saw_linear_ || has_nonzero_linear_ || moved_m_ > kMoved_m;
  const bool angular_known = !saw_angular_ || has_nonzero_angular_ || turned_rad_ > kTurned_rad;
  if (!linear_known || !angular_known) return false;
  has_linear_ = has_nonzero_linear_;
  has_angular_ = has_nonzero_angular_;
  if (!has_linear_) return true;
  if (stated_frame_ != TwistFrame::kUndecided) {
    frame_ = stated_frame_;
    return true;
  }
  frame_ = detector_.decision().frame;
  if (frame_ == TwistFrame::kNeither) {
    phase_ = IntakePhase::kRefused;
    held_.clear();
  }
  return KnowsFrame() || HoverTellsNoMore();
}

bool SampleIntake::KnowsFrame() const {
  return frame_ == TwistFrame::kBody || frame_ == TwistFrame::kWorld;
}

bool SampleIntake::HoverTellsNoMore() const {
  return detector_.contradicts_none() && moves_since_ &&
         ToSeconds(*last_[kOdometry] - *moves_since_) > kHover_s;
}

/// Where the flow began without the frame of the twist.
void SampleIntake::FollowTwist(const OdometryInput& input) {
  if (!has_linear_ || frame_ != TwistFrame::kUndecided || !input.linear) return;
  detector_.AddSample(input.sample.stamp, input.sample.p_WS, input.sample.q_WS, *input.linear);
  frame_ = detector_.decision().frame;
  if (frame_ == TwistFrame::kNeither) phase_ = IntakePhase::kRefused;
}

std::string SampleIntake::WaitingFor() const {
  if (phase_ != IntakePhase::kHolding || decided_) return "";
  if (!first_[kOdometry] && !first_[kPose]) return "odometry or pose";
  if (rotors_.from_commands) {
    if (!first_[kCommands]) return "motor_commands";
  } else if (!first_[kRotors] && !first_[kJoints]) {
    return "rotor_speeds or joint_states";
  }
  if (rotors_.needs_voltage && !first_[kBattery]) return "battery_state";
  if (first_[kOdometry] && saw_linear_ && has_nonzero_linear_ &&
      stated_frame_ == TwistFrame::kUndecided && !detector_.decided()) {
    return "motion that tells the frame of the twist (or say so: twist_frame)";
  }
  return "the first second of samples and motion";
}

void SampleIntake::Forget() {
  const Stamp newest = StampOf(held_.back());
  while (ToSeconds(newest - StampOf(held_.front())) > kHold_s || held_.size() > kMostHeld) {
    held_.pop_front();
    ++forgotten_;
  }
}

// ---- Passing -----------------------------------------------------------------------------------

void SampleIntake::Release() {
  phase_ = IntakePhase::kFlowing;
  for (const InputSample& input : held_) Pass(input);
  held_.clear();
}

void SampleIntake::Pass(const InputSample& input) {
  if (const auto* odometry = std::get_if<OdometryInput>(&input)) {
    if (odometry->is_pose != use_pose_) return;
    OdometrySample sample = odometry->sample;
    if (odometry->linear && has_linear_ && KnowsFrame()) {
      sample.v_WS = TwistInWorld(frame_, sample.q_WS, *odometry->linear);
    }
    if (!has_angular_) sample.w_WS_S.reset();
    ready_.emplace_back(sample);
  } else if (const auto* imu = std::get_if<ImuInput>(&input)) {
    ready_.emplace_back(imu->sample);
  } else if (const auto* rotors = std::get_if<RotorInput>(&input)) {
    const bool wanted = rotors->from_joints == use_joints_ && !rotors_.from_commands;
    if (wanted) ready_.emplace_back(rotors->sample);
  } else if (const auto* battery = std::get_if<BatterySample>(&input)) {
    ready_.emplace_back(*battery);
  } else {
    ready_.emplace_back(std::get<CommandSample>(input));
  }
}

}  // namespace odmc
