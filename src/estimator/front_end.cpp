#include "odmc/estimator/front_end.h"

#include <algorithm>

#include "odmc/math/so3.h"

namespace odmc {
namespace {

using Eigen::Vector3d;

constexpr double kNoiseWarmUp_s = 0.3;  // of odometry before the first keyframe

// A jump exceeds the sensors' noise by so many sigmas of it, and what interpolation leaves: a
// position that velocities do not explain, or, without velocities, what no vehicle can accelerate.
constexpr double kJumpSigmas = 8.0;
constexpr double kUnexplainedWay_m = 0.01, kUnexplainedSpeed_m_s = 0.5;
constexpr double kLeastStep_m = 0.002, kLeastTurn_rad = 0.01;
constexpr double kMostAcceleration_m_s2 = 40.0, kMostAngularAcceleration_rad_s2 = 300.0;

OdometryNoise Configured(const EstimatorOptions& options) {
  return {options.position_noise_m, options.attitude_noise_rad, options.velocity_noise_m_s,
          options.rate_noise_rad_s};
}

/// Gyro bias in force; zero where there is none yet.
Vector3d GyroBias(const Window& window) {
  if (window.biases().empty()) return Vector3d::Zero();
  return Eigen::Map<const Vector3d>(window.biases().back().x.data());
}

}  // namespace

FrontEnd::FrontEnd(const DynamicModel* model, const EstimatorOptions* options)
    : model_(model),
      options_(options),
      synchroniser_(options->keyframe_rate_hz, options->patience_s),
      stream_noise_(Configured(*options)),
      phases_(model, options->phases, options->detect_changes),
      load_(*model, true) {}

void FrontEnd::Add(const OdometrySample& sample) {
  if (synchroniser_.Add(sample)) stream_noise_.Add(sample);
  if (noise_ready_ == 0) noise_ready_ = sample.stamp + FromSeconds(kNoiseWarmUp_s);
}

void FrontEnd::Add(const RotorSample& sample) {
  if (synchroniser_.Add(sample)) stream_noise_.Add(sample);
}

void FrontEnd::Finish() {
  synchroniser_.Finish();
  noise_ready_ = std::min(noise_ready_, synchroniser_.newest_odometry());
}

void FrontEnd::Restart() {
  synchroniser_.Clear();
  stream_noise_.Restart();
  phases_.Restart();
  load_.Reset();
  carrier_.reset();
  last_.reset();
  before_last_.reset();
  is_chained_ = false;
  first_stamp_.reset();  // another flight, or another clock
  noise_ready_ = 0;
}

void FrontEnd::CarryOn(const FrontEnd& before) {
  synchroniser_ = before.synchroniser_;
  phases_.CarryOn(before.phases_);
  stream_noise_ = before.stream_noise_;
  last_ = before.last_;
  before_last_ = before.before_last_;
  first_stamp_ = before.first_stamp_;
  noise_ready_ = before.noise_ready_;
}

std::optional<OdometrySample> FrontEnd::NextKeyframe() {
  // The first keyframe waits until the noise of the streams is known.
  if (!last_ && !synchroniser_.HasReached(noise_ready_)) return std::nullopt;
  std::optional<OdometrySample> sample = synchroniser_.NextKeyframe();
  if (!sample) return sample;
  if (!first_stamp_) first_stamp_ = sample->stamp;
  stream_noise_.AdvanceTo(std::max(sample->stamp, noise_ready_));
  return sample;
}

PhaseVerdict FrontEnd::FollowPhase(const OdometrySample& newest) {
  step_.dt = last_ ? ToSeconds(newest.stamp - last_->stamp) : 0.0;
  step_.rotors.reset();
  // Keyframes may be meant to be farther apart than a gap is long.
  step_.is_gap = step_.dt > std::max(OdometryHole_s(), 1.5 / options_->keyframe_rate_hz);
  step_.is_jump = last_ && !step_.is_gap && IsJump(newest, step_.dt);
  if (last_ && !step_.is_gap) {
    step_.rotors = ReduceRotors(synchroniser_.rotors(), last_->stamp, newest.stamp,
                                synchroniser_.rotor_pace().Hole_s(options_->max_gap_s));
  }
  const bool is_first = !last_ || step_.is_gap || step_.is_jump;
  return phases_.Update(newest, step_.rotors, stream_noise_.odometry(), is_first);
}

void FrontEnd::FollowLoad(const OdometrySample& newest, const Window& window) {
  if (!model_->pendulum()) return;
  const std::optional<Carrier> before = carrier_;
  carrier_.reset();
  if (!newest.v_WS) return;
  const std::optional<Vector3d> w_S =
      newest.w_WS_S ? newest.w_WS_S : GyroRate(newest.stamp, window);
  carrier_ = {newest.stamp,
              {*newest.v_WS, newest.q_WS.toRotationMatrix(), w_S.value_or(Vector3d::Zero())}};
  // Differences of one and the same velocity, so that its noise does not add up.
  if (!before) return;
  const double dt = ToSeconds(newest.stamp - before->stamp);
  load_pull_ = load_.Advance(before->motion, carrier_->motion, dt, window.values());
}

std::optional<KeyframeInterval> FrontEnd::Read(const OdometrySample& newest,
                                               const Window& window) const {
  if (!last_ || is_gap() || is_jump()) return std::nullopt;
  KeyframeInterval interval;
  interval.dt = step_.dt;
  interval.rotors = *step_.rotors;
  interval.load = load_pull_;
  if (has_imu()) {
    interval.imu = PreintegrateImu(synchroniser_.imu(), last_->stamp, newest.stamp,
                                   GyroBias(window), options_->max_gap_s);
  }
  return interval;
}

State FrontEnd::InitialState(const OdometrySample& newest, const KeyframeInterval* interval,
                             const Window& window) const {
  State state;
  state.p_WS = newest.p_WS;
  state.q_WS = newest.q_WS;
  const State before =
      interval != nullptr ? State::FromBlock(window.keyframes().back().x.data()) : State();
  if (newest.v_WS) {
    state.v_WS = *newest.v_WS;
  } else if (interval != nullptr) {
    state.v_WS = (newest.p_WS - last_->p_WS) / interval->dt;
  }
  // Turns between noisy poses are a poor rate, and that of the interval's middle.
  if (newest.w_WS_S) {
    state.w_WS_S = *newest.w_WS_S;
  } else if (const std::optional<Vector3d> rate = GyroRate(newest.stamp, window)) {
    state.w_WS_S = *rate;
  } else if (interval != nullptr) {
    state.w_WS_S = Log(before.q_WS.conjugate() * newest.q_WS) / interval->dt;
  }
  return state;
}

void FrontEnd::Keep(const OdometrySample& newest) {
  before_last_ = last_;
  last_ = newest;
  synchroniser_.Trim(newest.stamp);
}

bool FrontEnd::IsLeftOut(const OdometrySample& newest) const {
  return (is_held_out_ && is_held_out_(newest.stamp)) ||
         phase_detector().IsNearGround(newest.p_WS.z());
}

/// A pose that moves without velocity is a relabelled marker or a loop closure, not flight.
bool FrontEnd::IsJump(const OdometrySample& newest, double dt) const {
  const OdometryNoise noise = stream_noise_.odometry();
  if (newest.v_WS && last_->v_WS) {
    const Vector3d step = newest.p_WS - last_->p_WS - 0.5 * dt * (*newest.v_WS + *last_->v_WS);
    if (step.norm() > kUnexplainedWay_m + kJumpSigmas * noise.position_m +
                          dt * (kUnexplainedSpeed_m_s + kJumpSigmas * noise.velocity_m_s)) {
      return true;
    }
  }
  if (!before_last_) return false;
  const double dt0 = ToSeconds(last_->stamp - before_last_->stamp);
  if (!(dt0 > 0.0) || dt0 > OdometryHole_s()) return false;
  const double wider = dt * std::max(dt, dt0);
  const double share = dt / dt0;
  const double sigmas = kJumpSigmas * (1.0 + share);
  const Vector3d turned = Log(last_->q_WS.conjugate() * newest.q_WS);
  const auto is_turn = [&](const Vector3d& expected) {
    return (turned - expected).norm() >
           kLeastTurn_rad + sigmas * noise.attitude_rad + kMostAngularAcceleration_rad_s2 * wider;
  };
  // Rates that explain the turn are no jump; rates that do not may be wrong themselves.
  const bool has_rates = newest.w_WS_S && last_->w_WS_S;
  if (is_turn(share * Log(before_last_->q_WS.conjugate() * last_->q_WS)) &&
      (!has_rates || is_turn(0.5 * dt * (*newest.w_WS_S + *last_->w_WS_S)))) {
    return true;
  }
  if (newest.v_WS && last_->v_WS) return false;
  const Vector3d step = newest.p_WS - last_->p_WS - share * (last_->p_WS - before_last_->p_WS);
  return step.norm() > kLeastStep_m + sigmas * noise.position_m + kMostAcceleration_m_s2 * wider;
}

/// Body rate in S that the gyro reads at `stamp`, its bias taken off; nothing without samples
/// around it.
std::optional<Vector3d> FrontEnd::GyroRate(Stamp stamp, const Window& window) const {
  const Ring<ImuSample>& imu = synchroniser_.imu();
  const auto after = std::upper_bound(imu.begin(), imu.end(), stamp,
                                      [](Stamp s, const ImuSample& m) { return s < m.stamp; });
  if (after == imu.begin()) return std::nullopt;
  const ImuSample& a = *(after - 1);
  if (!a.gyro_I) return std::nullopt;
  Vector3d gyro_I = *a.gyro_I;
  if (a.stamp != stamp) {
    if (after == imu.end() || !after->gyro_I) return std::nullopt;
    const double span_s = ToSeconds(after->stamp - a.stamp);
    if (span_s > options_->max_gap_s) return std::nullopt;
    gyro_I += ToSeconds(stamp - a.stamp) / span_s * (*after->gyro_I - *a.gyro_I);
  }
  if (!window.biases().empty()) gyro_I -= GyroBias(window);
  const BodyProperties body = model_->Properties(window.values());
  return body.R_BS.transpose() * (body.R_BI * gyro_I);
}

}  // namespace odmc
