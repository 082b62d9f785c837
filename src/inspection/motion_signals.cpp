#include "odmc/inspection/motion_signals.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "odmc/math/so3.h"
#include "odmc/math/statistics.h"
#include "odmc/sensing/flight_checks.h"

namespace odmc {
namespace {

using Eigen::MatrixXd;
using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr double kStretch_s = 10.0;
// Standing, the mean pose of a quarter of a second stays to the noise of its mean: motion capture
// and onboard filters 1 mm and less, simulated odometry of 1 cm at 100 Hz 2 mm.
constexpr double kMoved_m = 0.006, kTurned_rad = 0.01;
// Free fall aside, thrust of a multirotor lies between a third of the most that it holds for long
// and that; idling rotors give a tenth.
constexpr double kLeastThrust = 0.3;

/// Which times of a recording are looked at.
class Excerpt {
 public:
  explicit Excerpt(double duration_s)
      : whole_(duration_s <= kLongestLook_s), period_s_(duration_s * kStretch_s / kLongestLook_s) {}

  bool Has(double t_s) const {
    return whole_ || (t_s >= 0.0 && std::fmod(t_s, period_s_) < kStretch_s);
  }

 private:
  bool whole_;
  double period_s_;
};

/// Samples gathered for a signal.
class Gatherer {
 public:
  explicit Gatherer(int channels) : channels_(channels) {}

  template <typename Values>
  void Add(double t_s, const Values& values) {
    times_s_.push_back(t_s);
    for (int i = 0; i < channels_; ++i) values_.push_back(values[i]);
  }

  std::optional<SampledSignal> Signal() {
    const auto n = static_cast<Eigen::Index>(times_s_.size());
    if (n < 5) return std::nullopt;
    MatrixXd values = Eigen::Map<MatrixXd>(values_.data(), channels_, n);
    return SampledSignal(std::move(times_s_), std::move(values));
  }

 private:
  int channels_;
  std::vector<double> times_s_, values_;
};

/// Attitude's quaternion next to the one before, of its two signs.
Eigen::Vector4d Nearer(const Eigen::Vector4d& q, const Eigen::Vector4d& before) {
  return q.dot(before) < 0.0 ? Eigen::Vector4d(-q) : q;
}

struct PoseSignals {
  std::optional<SampledSignal> position, attitude, velocity, rates;
};

PoseSignals GatherPoses(const FlightLog& log, const Excerpt& excerpt) {
  Gatherer position(3), attitude(4), velocity(3), rates(3);
  const OdometrySample* last = nullptr;
  Eigen::Vector4d q(0.0, 0.0, 0.0, 1.0);
  for (const OdometrySample& s : log.odometry) {
    const double t_s = FlightSeconds(s.stamp, log);
    if (!excerpt.Has(t_s)) continue;
    const bool repeated = last != nullptr && IsSamePose(s, *last);
    last = &s;
    if (repeated) continue;
    q = Nearer(s.q_WS.coeffs(), q);
    position.Add(t_s, s.p_WS);
    attitude.Add(t_s, q);
    if (s.v_WS) velocity.Add(t_s, *s.v_WS);
    if (s.w_WS_S) rates.Add(t_s, *s.w_WS_S);
  }
  return {position.Signal(), attitude.Signal(), velocity.Signal(), rates.Signal()};
}

}  // namespace

Quaterniond MotionSignals::q_WS(double t_s) const {
  return Quaterniond(Eigen::Vector4d(attitude.At(t_s).normalized()));
}

double FlightSeconds(Stamp stamp, const FlightLog& log) {
  return ToSeconds(stamp - log.odometry.front().stamp);
}

std::optional<MotionSignals> SignalsOf(const FlightLog& log) {
  if (log.odometry.size() < 5) return std::nullopt;
  const Excerpt excerpt(FlightSeconds(log.odometry.back().stamp, log));
  PoseSignals poses = GatherPoses(log, excerpt);
  if (!poses.position) return std::nullopt;
  Gatherer gyro(3), accelerometer(3);
  for (const ImuSample& s : log.imu) {
    const double t_s = FlightSeconds(s.stamp, log);
    if (!excerpt.Has(t_s)) continue;
    if (s.gyro_I) gyro.Add(t_s, *s.gyro_I);
    if (s.specific_force_I) accelerometer.Add(t_s, *s.specific_force_I);
  }
  Gatherer rotors(log.rotors.empty() ? 0 : static_cast<int>(log.rotors.front().speed.size()));
  for (const RotorSample& s : log.rotors) {
    const double t_s = FlightSeconds(s.stamp, log);
    if (excerpt.Has(t_s)) rotors.Add(t_s, s.speed.cwiseAbs2().eval());
  }
  return MotionSignals{*poses.position, *poses.attitude,        poses.velocity, poses.rates,
                       gyro.Signal(),   accelerometer.Signal(), rotors.Signal()};
}

SampledSignal DifferencesOf(const SampledSignal& position) {
  const auto& t = position.times_s();
  std::vector<double> middle;
  MatrixXd values(position.channels(), position.size() - 1);
  for (int i = 1; i < position.size(); ++i) {
    middle.push_back(0.5 * (t[i - 1] + t[i]));
    values.col(i - 1) =
        (position.values().col(i) - position.values().col(i - 1)) / (t[i] - t[i - 1]);
  }
  return SampledSignal(std::move(middle), std::move(values));
}

SampledSignal TurnsOf(const SampledSignal& attitude) {
  const auto& t = attitude.times_s();
  std::vector<double> middle;
  MatrixXd values(3, attitude.size() - 1);
  for (int i = 1; i < attitude.size(); ++i) {
    const Quaterniond before(Eigen::Vector4d(attitude.values().col(i - 1)));
    const Quaterniond now(Eigen::Vector4d(attitude.values().col(i)));
    middle.push_back(0.5 * (t[i - 1] + t[i]));
    values.col(i - 1) = Log((before.conjugate() * now).normalized()) / (t[i] - t[i - 1]);
  }
  return SampledSignal(std::move(middle), std::move(values));
}

std::vector<bool> FindFlight(const MotionSignals& s) {
  const int n = static_cast<int>(s.position.last_s() / kFlightStep_s);
  std::vector<bool> moves(static_cast<size_t>(std::max(n, 0)), false);
  std::vector<double> thrust(moves.size(), 0.0), flown;
  for (int i = 0; i < n; ++i) {
    const double from = i * kFlightStep_s, to = from + kFlightStep_s;
    if (!s.position.Covers(from, to)) continue;
    if (s.rotors && s.rotors->Covers(from, to)) thrust[i] = s.rotors->Mean(from, to).sum();
    for (const double other : {from - kFlightStep_s, to}) {
      if (!s.position.Covers(other, other + kFlightStep_s)) continue;
      const double moved =
          (s.position.Mean(from, to) - s.position.Mean(other, other + kFlightStep_s)).norm();
      const double turned =
          2.0 * (s.attitude.Mean(from, to) - s.attitude.Mean(other, other + kFlightStep_s)).norm();
      moves[i] = moves[i] || moved > kMoved_m || turned > kTurned_rad;
    }
    if (moves[i]) flown.push_back(thrust[i]);
  }
  const double least = kLeastThrust * Quantile(flown, 0.9);
  for (int i = 0; i < n; ++i) moves[i] = moves[i] && (!s.rotors || thrust[i] > least);
  return moves;
}

bool IsInFlight(const std::vector<bool>& flight, double t_s) {
  const auto i = static_cast<size_t>(std::max(0.0, t_s / kFlightStep_s));
  return i < flight.size() && flight[i];
}

}  // namespace odmc
