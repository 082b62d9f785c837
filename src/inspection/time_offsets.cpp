#include "odmc/inspection/time_offsets.h"

#include <algorithm>
#include <cmath>

#include "odmc/math/so3.h"

namespace odmc {
namespace {

using Eigen::MatrixXd;
using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr double kStep_s = 0.01;  // bandwidth 50 Hz: above what rotors and bodies do
constexpr double kSlowWidth_s = 0.1;
// The difference of means over neighbouring steps weighs accelerations by a triangle; a mean over
// sqrt(2) steps has its variance in time.
constexpr double kHat = 1.414;

// As kAnswer_s of lag_regression.cpp, for thrust, which a position controller answers with, five
// times slower.
constexpr double kThrustAnswer_s = 0.025, kLeastShare = 0.1;

constexpr double kObserver_s = 0.2;

/// Even grid over the flight, no finer than the streams are.
LagProblem Grid(const SampledSignal& still, const SampledSignal& moving, int channels, int fixed) {
  LagProblem p;
  // Lines between samples smooth differently at samples and between them; over two steps it hardly
  // shows.
  p.step_s = std::max({kStep_s, 2.0 * still.step_s(), 2.0 * moving.step_s()});
  p.width_s = p.step_s;
  p.first_s = std::max(0.0, still.first_s()) + p.step_s;
  const int n = std::max(0, static_cast<int>((still.last_s() - p.first_s) / p.step_s) - 1);
  p.y = MatrixXd::Zero(n, channels);
  p.fixed = MatrixXd::Zero(n, fixed);
  p.usable.assign(static_cast<size_t>(n), false);
  p.moving = &moving;
  return p;
}

/// The same for streams that measure one motion: in the band of the motion itself, where what a
/// filter of either smooths, and white noise, show least. No controller stands between them.
LagProblem SlowGrid(const SampledSignal& still, const SampledSignal& moving, int channels,
                    int fixed) {
  LagProblem p = Grid(still, moving, channels, fixed);
  p.width_s = std::max(kSlowWidth_s, 2.0 * p.step_s);
  const double step_s = 0.5 * p.width_s;
  const auto n = static_cast<Eigen::Index>(static_cast<double>(p.y.rows()) * p.step_s / step_s);
  p.step_s = step_s;
  p.memory_s = 0.0;
  p.y = MatrixXd::Zero(n, channels);
  p.fixed = MatrixXd::Zero(n, fixed);
  p.usable.assign(static_cast<size_t>(n), false);
  return p;
}

/// Calls `fill(i, from_s, to_s)`, which says if the step can be used, for every step in flight that
/// all of `streams` cover.
template <typename Fill>
void ForSteps(const std::vector<const SampledSignal*>& streams, const std::vector<bool>& flight,
              LagProblem* p, Fill fill) {
  for (int i = 0; i < p->y.rows(); ++i) {
    const double t = p->first_s + i * p->step_s;
    const double span_s = p->memory_s > 0.0 ? p->step_s : p->width_s;
    const double from = t - 0.5 * span_s, to = t + 0.5 * span_s;
    if (!IsInFlight(flight, t)) continue;
    if (!std::all_of(streams.begin(), streams.end(),
                     [&](const SampledSignal* s) { return s->Covers(from, to); })) {
      continue;
    }
    p->usable[static_cast<size_t>(i)] = fill(i, from, to);
  }
}

std::optional<TimeOffset> Offset(const LagProblem& problem, const std::string& stream,
                                 const std::string& against) {
  const std::optional<StreamLag> lag = EstimateLag(problem);
  if (!lag) return std::nullopt;
  return TimeOffset{stream, against, *lag};
}

std::optional<TimeOffset> AgainstAttitude(const MotionSignals& s, const SampledSignal& rates,
                                          const std::vector<bool>& flight,
                                          const std::string& stream) {
  LagProblem p = SlowGrid(s.attitude, rates, 3, 1);
  ForSteps({&s.attitude}, flight, &p, [&](int i, double from, double to) {
    p.y.row(i) = (Log(s.q_WS(from).conjugate() * s.q_WS(to)) / (to - from)).transpose();
    p.fixed(i, 0) = 1.0;
    return true;
  });
  return Offset(p, stream, "attitude");
}

}  // namespace

std::optional<TimeOffset> VelocityOffset(const MotionSignals& s, const std::vector<bool>& flight) {
  if (!s.velocity) return std::nullopt;
  LagProblem p = SlowGrid(s.position, *s.velocity, 3, 1);
  p.filter_s = kObserver_s;
  ForSteps({&s.position}, flight, &p, [&](int i, double from, double to) {
    p.y.row(i) = ((s.position.At(to) - s.position.At(from)) / (to - from)).transpose();
    p.fixed(i, 0) = 1.0;
    return true;
  });
  return Offset(p, "velocity", "position");
}

std::optional<TimeOffset> RatesOffset(const MotionSignals& s, const std::vector<bool>& flight) {
  if (!s.rates) return std::nullopt;
  return AgainstAttitude(s, *s.rates, flight, "body_rates");
}

std::optional<TimeOffset> GyroOffset(const MotionSignals& s, const std::vector<bool>& flight) {
  if (!s.gyro) return std::nullopt;
  return AgainstAttitude(s, *s.gyro, flight, "gyro");
}

std::optional<TimeOffset> AccelerometerOffset(const MotionSignals& s, const Vehicle& vehicle,
                                              const std::vector<bool>& flight) {
  if (!s.accelerometer) return std::nullopt;
  const SampledSignal velocity = s.velocity ? *s.velocity : DifferencesOf(s.position);
  const Vector3d up_W = vehicle.gravity_m_s2 * Vector3d::UnitZ();
  LagProblem p = SlowGrid(velocity, *s.accelerometer, 3, 1);
  p.filter_s = kObserver_s;
  ForSteps({&velocity, &s.attitude}, flight, &p, [&](int i, double from, double to) {
    const Vector3d a_W = (velocity.At(to) - velocity.At(from)) / (to - from);
    p.y.row(i) = (s.q_WS(0.5 * (from + to)).conjugate() * (a_W + up_W)).transpose();
    p.fixed(i, 0) = 1.0;
    return true;
  });
  return Offset(p, "accelerometer", s.velocity ? "velocity" : "position");
}

std::optional<TimeOffset> RotorOffset(const MotionSignals& s, const Vehicle& vehicle,
                                      const std::vector<bool>& flight) {
  if (!s.rotors) return std::nullopt;
  const bool from_gyro = !s.rates && s.gyro && vehicle.imu;
  const SampledSignal rates = s.rates ? *s.rates : from_gyro ? *s.gyro : TurnsOf(s.attitude);
  const Eigen::Matrix3d R_BS =
      (from_gyro ? vehicle.imu->q_BS : vehicle.odometry.q_BS).toRotationMatrix();
  const SampledSignal velocity = s.velocity ? *s.velocity : DifferencesOf(s.position);
  LagProblem p = Grid(rates, *s.rotors, 2, 9);
  p.width_s = kHat * p.step_s;
  ForSteps({&rates, &velocity}, flight, &p, [&](int i, double from, double to) {
    const double t = 0.5 * (from + to), h = to - from;
    if (!rates.Covers(t - h, t + h) || !velocity.Covers(t - h, t + h)) return false;
    const Vector3d w_B = R_BS * Vector3d(rates.Mean(t - h, t + h));
    const Vector3d w_dot_B = R_BS * Vector3d((rates.Mean(t, t + h) - rates.Mean(t - h, t)) / h);
    const Vector3d v_B = R_BS * (s.q_WS(t).conjugate() * Vector3d(velocity.Mean(t - h, t + h)));
    p.y.row(i) = w_dot_B.head<2>().transpose();
    p.fixed.row(i) << w_B.transpose(), v_B.transpose(), w_B.y() * w_B.z(), w_B.x() * w_B.z(), 1.0;
    return true;
  });
  return Offset(p, "rotor_speeds", s.rates ? "body_rates" : from_gyro ? "gyro" : "attitude");
}

std::optional<TimeOffset> ThrustOffset(const MotionSignals& s, const Vehicle& vehicle,
                                       const std::vector<bool>& flight) {
  if (!s.rotors) return std::nullopt;
  const SampledSignal velocity = s.velocity ? *s.velocity : DifferencesOf(s.position);
  const Eigen::Matrix3d R_BS = vehicle.odometry.q_BS.toRotationMatrix();
  const Vector3d up_W = vehicle.gravity_m_s2 * Vector3d::UnitZ();
  const SampledSignal thrust(s.rotors->times_s(), s.rotors->values().colwise().sum());
  LagProblem p = Grid(velocity, thrust, 1, 3);
  p.width_s = kHat * p.step_s;
  ForSteps({&velocity, &s.attitude}, flight, &p, [&](int i, double from, double to) {
    const double t = 0.5 * (from + to), h = to - from;
    if (!velocity.Covers(t - h, t + h)) return false;
    const Eigen::Matrix3d R_BW = R_BS * s.q_WS(t).conjugate().toRotationMatrix();
    const Vector3d a_W = (velocity.Mean(t, t + h) - velocity.Mean(t - h, t)) / h;
    const Vector3d v_B = R_BW * Vector3d(velocity.Mean(t - h, t + h));
    p.y(i, 0) = (R_BW * (a_W + up_W)).z();
    p.fixed.row(i) << v_B.z(), v_B.head<2>().squaredNorm(), 1.0;
    return true;
  });
  auto offset = Offset(p, "rotor_speeds", s.velocity ? "velocity" : "position");
  // Thrust is read between 3 and 20 Hz by nobody: it is judged by what it explains of all.
  if (offset) {
    const double share = std::clamp(offset->lag.explained, kLeastShare, 1.0);
    offset->lag.pull_s = kThrustAnswer_s * (1.0 - share) / share;
  }
  return offset;
}
std::optional<TimeOffset> CombinedOffset(const std::optional<TimeOffset>& a,
                                         const std::optional<TimeOffset>& b) {
  if (!a || !a->lag.determined()) return b && b->lag.determined() ? b : a;
  if (!b || !b->lag.determined()) return a;
  const auto precision = [](const TimeOffset& offset) {
    return 1.0 / (offset.lag.sigma_s() * offset.lag.sigma_s());
  };
  const double share = precision(*b) / (precision(*a) + precision(*b));
  TimeOffset both = share < 0.5 ? *a : *b;
  both.lag.lag_s = (1.0 - share) * a->lag.lag_s + share * b->lag.lag_s;
  // Where they contradict each other by more than their sigmas, these are too small.
  const double apart_s = b->lag.lag_s - a->lag.lag_s;
  const double expected_s = std::hypot(a->lag.sigma_s(), b->lag.sigma_s());
  const double widen = std::max(1.0, std::abs(apart_s) / expected_s);
  const auto mixed = [&](double StreamLag::*part) {
    return widen * std::hypot((1.0 - share) * a->lag.*part, share * b->lag.*part);
  };
  const double scatter_s = mixed(&StreamLag::scatter_s), pull_s = mixed(&StreamLag::pull_s);
  both.lag.scatter_s = scatter_s;
  both.lag.pull_s = pull_s;
  return both;
}

}  // namespace odmc
