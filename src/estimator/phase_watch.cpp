#include "odmc/estimator/phase_watch.h"

#include <algorithm>
#include <cmath>

#include "odmc/factors/interval_model.h"
#include "odmc/math/so3.h"

namespace odmc {
namespace {

using Eigen::Vector3d;

constexpr double kBaseline_s = 0.05;
constexpr double kReferenceEvery_s = 0.1;
// Between an estimate and the plain mean of thrust; drag and inflow are in one and not in the
// other.
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
  poses_ = before.poses_;
}

void PhaseWatch::Restart() {
  detector_.Restart();
  last_.reset();
  poses_.clear();
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
  if (!detector_.knows_thrust()) waiting_.clear();
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

/// Motion of a keyframe. What the odometry lacks comes from the poses before it, over kBaseline_s:
/// between neighbours their noise would be all there is.
State PhaseWatch::MotionOf(const OdometrySample& sample) const {
  State state;
  state.p_WS = sample.p_WS;
  state.q_WS = sample.q_WS;
  const OdometrySample& earlier = poses_.empty() ? sample : poses_.front();
  const bool has_earlier = !poses_.empty();
  if (sample.v_WS) {
    state.v_WS = *sample.v_WS;
  } else if (has_earlier) {
    state.v_WS = Velocity(earlier, sample);
  }
  if (sample.w_WS_S) {
    state.w_WS_S = *sample.w_WS_S;
  } else if (has_earlier) {
    state.w_WS_S = Rate(earlier, sample);
  }
  return state;
}

bool PhaseWatch::HasVelocity(const OdometrySample& sample) const {
  return sample.v_WS ||
         (!poses_.empty() && ToSeconds(sample.stamp - poses_.front().stamp) > 0.8 * kBaseline_s);
}

/// Keeps the poses of the last kBaseline_s.
void PhaseWatch::Keep(const OdometrySample& sample) {
  poses_.push_back(sample);
  while (poses_.size() > 1 && ToSeconds(sample.stamp - poses_[1].stamp) >= kBaseline_s) {
    poses_.pop_front();
  }
}

/// What is felt and what the model lacks of it, over the interval up to `sample`.
void PhaseWatch::AddForces(const State& s0, const State& s1, const RotorInterval& rotors,
                           PhaseEvidence* e) const {
  DynamicsMeasurement measurement;
  measurement.dt = e->dt;
  measurement.rotors = rotors.mean;
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
    poses_.clear();
    last_.reset();
  }
  const bool has_velocity = HasVelocity(sample);
  const State state = MotionOf(sample);
  PhaseEvidence e;
  e.stamp = sample.stamp;
  e.dt = poses_.empty() ? 0.0 : ToSeconds(sample.stamp - poses_.back().stamp);
  e.p_WS = sample.p_WS;
  e.q_WS = sample.q_WS;
  e.thrust_sigma = reference_.thrust_sigma;
  e.attitude_noise_rad = noise.attitude_rad;
  e.position_noise_m = noise.position_m;
  e.velocity_noise_m_s =
      sample.v_WS ? noise.velocity_m_s : std::sqrt(2.0) * noise.position_m / kBaseline_s;
  // Half the speed that pose noise alone would show is not motion.
  e.speed_m_s = sample.v_WS ? state.v_WS.norm()
                            : std::max(0.0, state.v_WS.norm() - 2.0 * e.velocity_noise_m_s);
  e.rate_rad_s = state.w_WS_S.norm();
  if (last_ && rotors) AddForces(*last_, state, *rotors, &e);
  last_.reset();
  if (has_velocity) last_ = state;
  Keep(sample);
  return detector_.Update(e);
}

}  // namespace odmc
