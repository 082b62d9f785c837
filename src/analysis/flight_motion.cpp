#include "odmc/analysis/flight_motion.h"

#include <algorithm>
#include <cmath>

#include "odmc/math/savitzky_golay.h"
#include "odmc/math/so3.h"
#include "odmc/math/statistics.h"

namespace odmc {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double kFilterWidth_s = 0.1;

/// Rows of the matrix of filtered channels.
enum Channel : int {
  kPosition = 0,
  kQuaternion = 3,
  kVelocity = 7,
  kRate = 10,
  kForce = 13,
  kRotors = 16
};

/// The recording as one matrix at the odometry's stamps: one column a sample.
struct Channels {
  std::vector<double> t_s;
  std::vector<Stamp> stamps;
  Eigen::MatrixXd data;
  std::vector<bool> covered;  // rotor speeds are there
  bool has_velocity = true, has_rate = true;
  std::vector<bool> felt;  // the accelerometer is there
};

Channels Collect(const FlightLog& log, int num_rotors) {
  Channels c;
  const int n = static_cast<int>(log.odometry.size());
  c.data = Eigen::MatrixXd::Zero(kRotors + num_rotors, n);
  c.covered.assign(n, false);
  c.felt.assign(n, false);
  size_t m = 0;
  Eigen::Quaterniond last = Eigen::Quaterniond::Identity();
  size_t r = 0;
  for (int i = 0; i < n; ++i) {
    const OdometrySample& s = log.odometry[i];
    c.stamps.push_back(s.stamp);
    c.t_s.push_back(ToSeconds(s.stamp - log.odometry.front().stamp));
    c.data.block<3, 1>(kPosition, i) = s.p_WS;
    Eigen::Vector4d q = s.q_WS.coeffs();
    if (i > 0 && q.dot(last.coeffs()) < 0.0) q = -q;
    last.coeffs() = q;
    c.data.block<4, 1>(kQuaternion, i) = q;
    c.has_velocity = c.has_velocity && s.v_WS.has_value();
    c.has_rate = c.has_rate && s.w_WS_S.has_value();
    if (s.v_WS) c.data.block<3, 1>(kVelocity, i) = *s.v_WS;
    if (s.w_WS_S) c.data.block<3, 1>(kRate, i) = *s.w_WS_S;
    // The accelerometer, linearly between its samples.
    while (m + 1 < log.imu.size() && log.imu[m + 1].stamp <= s.stamp) ++m;
    if (m < log.imu.size() && log.imu[m].stamp <= s.stamp && log.imu[m].specific_force_I) {
      const ImuSample& a = log.imu[m];
      if (a.stamp == s.stamp) {
        c.data.block<3, 1>(kForce, i) = *a.specific_force_I;
        c.felt[i] = true;
      } else if (m + 1 < log.imu.size() && log.imu[m + 1].specific_force_I) {
        const ImuSample& b = log.imu[m + 1];
        const double span = ToSeconds(b.stamp - a.stamp);
        const double x = ToSeconds(s.stamp - a.stamp) / span;
        c.felt[i] = span < 0.5 * kFilterWidth_s;
        c.data.block<3, 1>(kForce, i) = (1.0 - x) * *a.specific_force_I + x * *b.specific_force_I;
      }
    }
    while (r + 1 < log.rotors.size() && log.rotors[r + 1].stamp <= s.stamp) ++r;
    if (log.rotors.empty() || log.rotors[r].stamp > s.stamp) continue;
    RotorVector squared = log.rotors[r].speed.array().square();
    if (log.rotors[r].stamp < s.stamp) {
      if (r + 1 >= log.rotors.size()) continue;
      const double span = ToSeconds(log.rotors[r + 1].stamp - log.rotors[r].stamp);
      if (span > 0.5 * kFilterWidth_s) continue;
      const double x = ToSeconds(s.stamp - log.rotors[r].stamp) / span;
      const RotorVector speed = (1.0 - x) * log.rotors[r].speed + x * log.rotors[r + 1].speed;
      squared = speed.array().square();
    }
    c.data.block(kRotors, i, num_rotors, 1) = squared;
    c.covered[i] = true;
  }
  return c;
}

FilteredMotion MotionAt(const Channels& c, const LocalPolynomial& fit) {
  FilteredMotion motion;
  motion.p_WS = fit.value.segment<3>(kPosition);
  const Eigen::Quaterniond q(Eigen::Vector4d(fit.value.segment<4>(kQuaternion).normalized()));
  motion.R_WS = q.toRotationMatrix();
  motion.v_WS = c.has_velocity ? fit.value.segment<3>(kVelocity) : fit.first.segment<3>(kPosition);
  motion.a_WS = c.has_velocity ? fit.first.segment<3>(kVelocity) : fit.second.segment<3>(kPosition);
  if (c.has_rate) {
    motion.w_S = fit.value.segment<3>(kRate);
    motion.w_dot_S = fit.first.segment<3>(kRate);
  } else {
    // w = 2 vec(q* dq/dt), dw/dt = 2 vec(q* d²q/dt²).
    const Eigen::Quaterniond first(Eigen::Vector4d(fit.first.segment<4>(kQuaternion)));
    const Eigen::Quaterniond second(Eigen::Vector4d(fit.second.segment<4>(kQuaternion)));
    motion.w_S = 2.0 * (q.conjugate() * first).vec();
    motion.w_dot_S = 2.0 * (q.conjugate() * second).vec();
  }
  return motion;
}

bool OnGround(Stamp stamp, const std::vector<std::pair<Stamp, Stamp>>& spans) {
  return std::any_of(spans.begin(), spans.end(), [stamp](const auto& span) {
    return stamp >= span.first && stamp <= span.second;
  });
}

}  // namespace

FlightMotion FilterFlight(const FlightLog& log, int num_rotors,
                          const std::vector<std::pair<Stamp, Stamp>>& ground_spans) {
  FlightMotion flight;
  const Channels c = Collect(log, num_rotors);
  const int n = static_cast<int>(c.t_s.size());
  if (n < 5) return flight;
  std::vector<double> steps;
  for (int i = 1; i < n; ++i) steps.push_back(c.t_s[i] - c.t_s[i - 1]);
  const double step_s = Median(steps);
  flight.step_s = step_s;
  const SavitzkyGolay filter(SavitzkyGolay::NearestOddCount(kFilterWidth_s, step_s));
  const int half = filter.count() / 2;
  const double longest_s = 1.5 * std::max(kFilterWidth_s, filter.count() * step_s);
  int previous = -2;
  flight.samples.reserve(static_cast<size_t>(n));
  for (int i = half; i + half < n; ++i) {
    if (OnGround(c.stamps[i], ground_spans)) {
      ++flight.left_out_ground;
      continue;
    }
    bool whole = c.t_s[i + half] - c.t_s[i - half] < longest_s;
    for (int k = i - half; whole && k <= i + half; ++k) whole = c.covered[k];
    for (int k = i - half; whole && k < i + half; ++k) {
      whole = c.t_s[k + 1] - c.t_s[k] < std::max(3.5 * step_s, 0.02);
    }
    if (!whole) {
      ++flight.left_out_gaps;
      continue;
    }
    const LocalPolynomial fit = filter.At(c.t_s, c.data, i);
    FilteredMotion motion = MotionAt(c, fit);
    motion.t_s = c.t_s[i];
    motion.rotors.speed_squared = fit.value.tail(num_rotors).cwiseMax(0.0);
    motion.rotors.speed = motion.rotors.speed_squared.cwiseSqrt();
    motion.rotors.speed_squared_rate = fit.first.tail(num_rotors);
    motion.rotors.acceleration =
        motion.rotors.speed_squared_rate.cwiseQuotient((2.0 * motion.rotors.speed).cwiseMax(1.0));
    bool felt = true;
    for (int k = i - half; k <= i + half; ++k) felt = felt && c.felt[k];
    if (felt) motion.specific_force_I = fit.value.segment<3>(kForce);
    motion.follows = previous == i - 1;
    previous = i;
    flight.samples.push_back(motion);
  }
  return flight;
}

std::vector<Eigen::Vector3d> LoadPulls(const FlightMotion& flight, const DynamicModel& model,
                                       const ModelValues& values) {
  LoadObserver load(model, false);
  std::vector<Vector3d> pulls;
  pulls.reserve(flight.samples.size());
  double t_s = 0.0;
  Vector3d v_W = Vector3d::Zero();
  for (const FilteredMotion& now : flight.samples) {
    // The filter takes its first half window; before that the vehicle stood still or was on course.
    if (pulls.empty()) v_W = now.v_WS - std::min(now.t_s, kFilterWidth_s) * now.a_WS;
    // Through gaps with their mean acceleration, which leaves the velocity right.
    pulls.push_back(load.Advance(v_W, now.v_WS, now.t_s - t_s, values).pull_W);
    v_W = now.v_WS;
    t_s = now.t_s;
  }
  return pulls;
}

}  // namespace odmc
