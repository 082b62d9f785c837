#include "odmc/estimator/phase_watch.h"

#include <algorithm>
#include <cmath>

#include "odmc/factors/interval_model.h"
#include "odmc/math/so3.h"

namespace odmc {
namespace {

using Eigen::Vector3d;

constexpr double kReferenceEvery_s = 0.1;
// Between an estimate and the plain mean of thrust; drag and inflow are in one and not in the other.
constexpr double kAgrees = 0.1;
constexpr double kKnownSigma = 0.05;   // of a prior that says as much as a flight
constexpr double kUnknownSigma = 0.3;  // of a thrust coefficient that has no prior

/// Speed between two poses.
Vector3d Velocity(const OdometrySample& a, const OdometrySample& b) {
  return (b.p_WS - a.p_WS) / ToSeconds(b.stamp - a.stamp);
}

Vector3d Rate(const OdometrySample& a, const OdometrySample& b) {
  return Log(a.q_WS.conjugate() * b.q_WS) / ToSeconds(b.stamp - a.stamp);
}

/// State of a keyframe as the odometry has it.
/// @param before the keyframe before it, for what the odometry lacks
State StateOf(const OdometrySample& sample, const OdometrySample& before) {
  State state;
  state.p_WS = sample.p_WS;
  state.q_WS = sample.q_WS;
  state.v_WS = sample.v_WS ? *sample.v_WS : Velocity(before, sample);
  state.w_WS_S = sample.w_WS_S ? *sample.w_WS_S : Rate(before, sample);
  return state;
}

}  // namespace

PhaseWatch::PhaseWatch(const DynamicModel* model, const PhaseOptions& options, bool learns_changes)
    : model_(model), detector_(options, learns_changes) {
  Forget();
  if (reference_.thrust_sigma < kKnownSigma) detector_.KnowThrust();
}

void PhaseWatch::Forget() {
  reference_ = {0, model_->InitialValues(), PriorThrustSigma()};
  waiting_.clear();
}

void PhaseWatch::CarryOn(const PhaseWatch& before) {
  detector_ = before.detector_;
  last_ = before.last_;
  before_last_ = before.before_last_;
}

void PhaseWatch::Restart() {
  detector_.Restart();
  last_.reset();
  before_last_.reset();
  waiting_.clear();
}

double PhaseWatch::PriorThrustSigma() const {
  const int k_f = model_->IndexOf("thrust.k_f");
  if (k_f < 0) return 0.0;
  const ModelParameter& p = model_->parameters()[k_f];
  if (!p.estimated) return 0.0;
  return p.spec.prior_value > 0.0 ? p.spec.prior_sigma / p.spec.prior_value : kUnknownSigma;
}

void PhaseWatch::Learn(Stamp stamp, const ModelValues& values, double thrust_sigma) {
  if (detector_.suspects() || !detector_.teaches()) return;
  if (!waiting_.empty() && ToSeconds(stamp - waiting_.back().stamp) < kReferenceEvery_s) return;
  waiting_.push_back({stamp, values, thrust_sigma});
  if (!detector_.knows_thrust()) {
    const double off = Disagreement(values);
    if (off > kAgrees) return;
    reference_ = {stamp, values, std::max(thrust_sigma, off)};
    waiting_.clear();
    return detector_.KnowThrust();
  }
  while (!waiting_.empty() && ToSeconds(stamp - waiting_.front().stamp) > kReferenceAge_s) {
    reference_ = waiting_.front();
    waiting_.pop_front();
  }
}

/// How far the estimate's thrust is from what carries the vehicle, relative; 1 where that is not
/// known.
double PhaseWatch::Disagreement(const ModelValues& values) const {
  const std::optional<double> gain = detector_.ThrustGain();
  if (!gain) return 1.0;
  const int k_f = model_->IndexOf("thrust.k_f");
  const double estimated = k_f >= 0 ? values[k_f] / reference_.values[k_f] : 1.0;
  return std::abs(estimated / *gain - 1.0);
}

void PhaseWatch::Know(const ModelValues& values, double thrust_sigma) {
  reference_ = {1, values, thrust_sigma};
  detector_.KnowThrust();
}

double PhaseWatch::SpeedOf(const OdometrySample& sample, double dt,
                           const OdometryNoise& noise) const {
  if (sample.v_WS) return sample.v_WS->norm();
  if (dt <= 0.0) return 0.0;
  // Half the speed that pose noise alone would show is not motion.
  return std::max(0.0, Velocity(*last_, sample).norm() - 2.0 * noise.position_m / dt);
}

/// What is felt and what the model lacks of it, over the interval up to `sample`.
void PhaseWatch::AddForces(const OdometrySample& sample, const RotorInterval& rotors,
                           PhaseEvidence* e) const {
  if (!before_last_ && !last_->v_WS) return;  // no velocity at its start
  DynamicsMeasurement measurement;
  measurement.dt = e->dt;
  measurement.rotors = rotors.mean;
  const State s1 = StateOf(sample, *last_);
  State s0 = s1;
  if (before_last_) {
    s0 = StateOf(*last_, *before_last_);
  } else {
    s0.p_WS = last_->p_WS, s0.q_WS = last_->q_WS, s0.v_WS = *last_->v_WS;
    if (last_->w_WS_S) s0.w_WS_S = *last_->w_WS_S;
  }
  const IntervalModel interval(measurement, s0, s1, *model_, reference_.values, false, false);
  const double gravity = model_->vehicle().gravity_m_s2, weight = interval.body.mass * gravity;
  const Vector3d specific_B =
      interval.R_BW * ((interval.m1.v_WBcm - interval.m0.v_WBcm) / e->dt - interval.body.g_W);
  FlightState hover;
  hover.rotors = rotors.mean;
  Vector3d thrust_B, torque_B;
  model_->EvaluateWrench(hover, reference_.values, Vector3d::Zero(), &thrust_B, &torque_B);
  e->has_force = true;
  e->felt_force = specific_B / gravity;
  e->missing_force = e->felt_force - interval.F_B / weight;
  e->thrust_ratio = thrust_B.z() / weight;
}

PhaseVerdict PhaseWatch::Update(const OdometrySample& sample,
                                const std::optional<RotorInterval>& rotors,
                                const OdometryNoise& noise, bool is_first) {
  if (is_first) {
    last_.reset();
    before_last_.reset();
  }
  PhaseEvidence e;
  e.stamp = sample.stamp;
  e.dt = last_ ? ToSeconds(sample.stamp - last_->stamp) : 0.0;
  e.p_WS = sample.p_WS;
  e.q_WS = sample.q_WS;
  e.speed_m_s = SpeedOf(sample, e.dt, noise);
  if (sample.w_WS_S) {
    e.rate_rad_s = sample.w_WS_S->norm();
  } else if (e.dt > 0.0) {
    e.rate_rad_s = Rate(*last_, sample).norm();
  }
  e.thrust_sigma = reference_.thrust_sigma;
  e.velocity_noise_m_s = sample.v_WS || e.dt <= 0.0
                             ? noise.velocity_m_s
                             : std::sqrt(2.0) * noise.position_m / e.dt;
  e.attitude_noise_rad = noise.attitude_rad;
  e.position_noise_m = noise.position_m;
  if (e.dt > 0.0 && rotors) AddForces(sample, *rotors, &e);
  before_last_ = last_;
  last_ = sample;
  return detector_.Update(e);
}

}  // namespace odmc
