#include "odmc/analysis/flight_motion.h"

#include <algorithm>
#include <cmath>
#include <functional>

#include "odmc/inspection/sampled_signal.h"
#include "odmc/math/savitzky_golay.h"
#include "odmc/math/so3.h"
#include "odmc/math/statistics.h"
#include "odmc/sensing/stream_pace.h"

namespace odmc {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double kFilterWidth_s = 0.1;
constexpr double kLeastStand_s = 0.5;
constexpr double kPositionError_m = 0.02;  // three sigma of what odometry or motion capture drifts
constexpr double kFliesThere = 0.1;        // share of the flight

/// Rows of the matrix of filtered channels.
enum Channel : int {
  kPosition = 0,
  kQuaternion = 3,
  kVelocity = 7,
  kRate = 10,
  kForce = 13,
  kGyro = 16,
  kRotors = 19  // speeds, then their squares
};

/// A piece of the recording as one matrix at the odometry's stamps: one column a sample.
struct Channels {
  std::vector<double> t_s;
  std::vector<Stamp> stamps;
  Eigen::MatrixXd data;
  std::vector<bool> covered;  // all that most samples have: rotor speeds, velocity, body rates
  std::vector<bool> felt;     // the accelerometer is there
  std::vector<bool> turned;   // the gyro is there
};

/// Takes the recording into channels, piece after piece.
class Collector {
 public:
  Collector(const FlightLog& log, int num_rotors)
      : log_(log),
        num_rotors_(num_rotors),
        rotor_hole_s_(PaceOf(log.rotors).Hole_s(0.5 * kFilterWidth_s)) {
    // Most count: a few samples without velocity are a gap, not a reason to differentiate twice.
    const auto most_have = [&log](std::optional<Vector3d> OdometrySample::*what) {
      const auto has = [what](const OdometrySample& s) { return (s.*what).has_value(); };
      const auto count = std::count_if(log.odometry.begin(), log.odometry.end(), has);
      return 2 * static_cast<size_t>(count) > log.odometry.size();
    };
    has_velocity_ = most_have(&OdometrySample::v_WS);
    has_rate_ = most_have(&OdometrySample::w_WS_S);
  }

  bool has_velocity() const { return has_velocity_; }
  bool has_rate() const { return has_rate_; }

  /// Samples [begin, end) of the odometry; pieces begin no earlier than the one before.
  Channels Piece(int begin, int end) {
    Channels c;
    const int n = end - begin;
    c.data = Eigen::MatrixXd::Zero(kRotors + 2 * num_rotors_, n);
    c.covered.assign(n, false);
    c.felt.assign(n, false);
    c.turned.assign(n, false);
    const Stamp first = log_.odometry[begin].stamp;
    imu_ = LastAt(log_.imu, imu_, first);
    rotors_ = LastAt(log_.rotors, rotors_, first);
    size_t m = imu_, r = rotors_;
    for (int i = 0; i < n; ++i) {
      const OdometrySample& s = log_.odometry[begin + i];
      c.stamps.push_back(s.stamp);
      c.t_s.push_back(ToSeconds(s.stamp - log_.odometry.front().stamp));
      TakeOdometry(s, i, &c);
      m = LastAt(log_.imu, m, s.stamp);
      if (m < log_.imu.size()) {
        c.felt[i] =
            TakeImu(m, s.stamp, &ImuSample::specific_force_I, c.data.block<3, 1>(kForce, i));
        c.turned[i] = TakeImu(m, s.stamp, &ImuSample::gyro_I, c.data.block<3, 1>(kGyro, i));
      }
      r = LastAt(log_.rotors, r, s.stamp);
      if (r < log_.rotors.size()) TakeRotors(r, s.stamp, i, &c);
      if ((has_velocity_ && !s.v_WS) || (has_rate_ && !s.w_WS_S)) c.covered[i] = false;
    }
    return c;
  }

 private:
  /// Index from `from` on of the last sample that is not after `stamp`; `from` if all are.
  template <typename Sample>
  static size_t LastAt(const std::vector<Sample>& samples, size_t from, Stamp stamp) {
    while (from + 1 < samples.size() && samples[from + 1].stamp <= stamp) ++from;
    return from;
  }

  void TakeOdometry(const OdometrySample& s, int i, Channels* c) const {
    c->data.block<3, 1>(kPosition, i) = s.p_WS;
    Eigen::Vector4d q = s.q_WS.coeffs();
    if (i > 0 && q.dot(c->data.block<4, 1>(kQuaternion, i - 1)) < 0.0) q = -q;
    c->data.block<4, 1>(kQuaternion, i) = q;
    if (s.v_WS) c->data.block<3, 1>(kVelocity, i) = *s.v_WS;
    if (s.w_WS_S) c->data.block<3, 1>(kRate, i) = *s.w_WS_S;
  }

  /// A sensor of the IMU, linearly between its samples.
  /// @param m the last sample that is not after `stamp`
  /// @returns whether it is there
  bool TakeImu(size_t m, Stamp stamp, std::optional<Vector3d> ImuSample::*sensor,
               Eigen::Ref<Vector3d> to) const {
    const ImuSample& a = log_.imu[m];
    if (a.stamp > stamp || !(a.*sensor)) return false;
    if (a.stamp == stamp) {
      to = *(a.*sensor);
      return true;
    }
    if (m + 1 >= log_.imu.size() || !(log_.imu[m + 1].*sensor)) return false;
    const ImuSample& b = log_.imu[m + 1];
    const double span = ToSeconds(b.stamp - a.stamp);
    const double x = ToSeconds(stamp - a.stamp) / span;
    to = (1.0 - x) * *(a.*sensor) + x * *(b.*sensor);
    return span < 0.5 * kFilterWidth_s;
  }

  void TakeRotors(size_t r, Stamp stamp, int i, Channels* c) const {
    const RotorSample& a = log_.rotors[r];
    if (a.stamp > stamp) return;
    RotorVector speed = a.speed;
    if (a.stamp < stamp) {
      if (r + 1 >= log_.rotors.size()) return;
      const RotorSample& b = log_.rotors[r + 1];
      const double span = ToSeconds(b.stamp - a.stamp);
      if (span > rotor_hole_s_) return;
      const double x = ToSeconds(stamp - a.stamp) / span;
      speed = (1.0 - x) * a.speed + x * b.speed;
    }
    c->data.block(kRotors, i, num_rotors_, 1) = speed;
    c->data.block(kRotors + num_rotors_, i, num_rotors_, 1) = speed.cwiseAbs2();
    c->covered[i] = true;
  }

  const FlightLog& log_;
  int num_rotors_;
  double rotor_hole_s_;
  bool has_velocity_, has_rate_;
  size_t imu_ = 0, rotors_ = 0;  // where the last piece began
};

FilteredMotion MotionAt(const Collector& c, const LocalPolynomial& fit) {
  FilteredMotion motion;
  motion.p_WS = fit.value.segment<3>(kPosition);
  const Eigen::Quaterniond q(Eigen::Vector4d(fit.value.segment<4>(kQuaternion).normalized()));
  motion.R_WS = q.toRotationMatrix();
  motion.v_WS =
      c.has_velocity() ? fit.value.segment<3>(kVelocity) : fit.first.segment<3>(kPosition);
  motion.a_WS =
      c.has_velocity() ? fit.first.segment<3>(kVelocity) : fit.second.segment<3>(kPosition);
  if (c.has_rate()) {
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

double MedianStep(const FlightLog& log) {
  std::vector<double> steps;
  steps.reserve(log.odometry.size());
  const Stamp first = log.odometry.front().stamp;
  for (size_t i = 1; i < log.odometry.size(); ++i) {
    steps.push_back(ToSeconds(log.odometry[i].stamp - first) -
                    ToSeconds(log.odometry[i - 1].stamp - first));
  }
  return Median(steps);
}

/// True if the window around sample `i` of a piece has no gap.
bool IsWhole(const Channels& c, int i, int half, double longest_s, double step_s) {
  bool whole = c.t_s[i + half] - c.t_s[i - half] < longest_s;
  for (int k = i - half; whole && k <= i + half; ++k) whole = c.covered[k];
  for (int k = i - half; whole && k < i + half; ++k) {
    whole = c.t_s[k + 1] - c.t_s[k] < LongestStep(step_s);
  }
  return whole;
}

FilteredMotion FilteredAt(const Collector& collector, const Channels& c,
                          const SavitzkyGolay& filter, int num_rotors, int i) {
  const LocalPolynomial fit = filter.At(c.t_s, c.data, i);
  FilteredMotion motion = MotionAt(collector, fit);
  motion.t_s = c.t_s[i];
  motion.rotors.speed_squared = fit.value.tail(num_rotors).cwiseMax(0.0);
  motion.rotors.speed = motion.rotors.speed_squared.cwiseSqrt();
  motion.rotors.speed_squared_rate = fit.first.tail(num_rotors);
  // Of the speed itself: where it falls steeply, the polynomial of its square passes through zero.
  motion.rotors.acceleration = fit.first.segment(kRotors, num_rotors);
  const int half = filter.count() / 2;
  bool felt = true, turned = true;
  for (int k = i - half; k <= i + half; ++k) {
    felt = felt && c.felt[k];
    turned = turned && c.turned[k];
  }
  if (felt) motion.specific_force_I = fit.value.segment<3>(kForce);
  if (turned) motion.gyro = {fit.value.segment<3>(kGyro), fit.first.segment<3>(kGyro)};
  return motion;
}

// What an accelerometer feels and what the motion shows are two measurements, of other noise: one
// flight is judged by one of them. Where the accelerometer misses but some samples, it stays; so
// does the gyro.
template <typename Reading>
void LeaveOutWithout(std::optional<Reading> FilteredMotion::*sensor, FlightMotion* flight) {
  const auto felt = [sensor](const FilteredMotion& motion) { return (motion.*sensor).has_value(); };
  std::vector<FilteredMotion>& samples = flight->samples;
  const auto num_felt = std::count_if(samples.begin(), samples.end(), felt);
  const auto missed = static_cast<std::ptrdiff_t>(samples.size()) - num_felt;
  if (missed == 0 || missed >= num_felt) return;
  bool follows = true;
  for (FilteredMotion& motion : samples) {
    motion.follows = motion.follows && follows;
    follows = felt(motion);
  }
  samples.erase(std::remove_if(samples.begin(), samples.end(), std::not_fn(felt)), samples.end());
  flight->left_out_gaps += static_cast<int>(missed);
}

}  // namespace

MotionCounts FilterEach(const FlightLog& log, int num_rotors, const StampSpans& ground_spans,
                        const std::function<void(const FilteredMotion&)>& use) {
  constexpr int kPiece = 4096;
  MotionCounts counts;
  const int n = static_cast<int>(log.odometry.size());
  if (n < 5) return counts;
  counts.step_s = MedianStep(log);
  const SavitzkyGolay filter(SavitzkyGolay::NearestOddCount(kFilterWidth_s, counts.step_s));
  const int half = filter.count() / 2;
  const double longest_s = 1.5 * std::max(kFilterWidth_s, filter.count() * counts.step_s);
  Collector collector(log, num_rotors);
  int previous = -2;
  for (int begin = half; begin + half < n; begin += kPiece) {
    const int end = std::min(begin + kPiece, n - half);
    const Channels piece = collector.Piece(begin - half, end + half);
    for (int i = begin; i < end; ++i) {
      const int k = i - begin + half;
      if (IsInside(piece.stamps[k], ground_spans)) {
        ++counts.left_out_ground;
        continue;
      }
      if (!IsWhole(piece, k, half, longest_s, counts.step_s)) {
        ++counts.left_out_gaps;
        continue;
      }
      FilteredMotion motion = FilteredAt(collector, piece, filter, num_rotors, k);
      motion.follows = previous == i - 1;
      previous = i;
      use(motion);
    }
  }
  return counts;
}

FlightMotion FilterFlight(const FlightLog& log, int num_rotors, const StampSpans& ground_spans) {
  FlightMotion flight;
  flight.samples.reserve(log.odometry.size());
  static_cast<MotionCounts&>(flight) =
      FilterEach(log, num_rotors, ground_spans,
                 [&](const FilteredMotion& motion) { flight.samples.push_back(motion); });
  LeaveOutWithout(&FilteredMotion::specific_force_I, &flight);
  LeaveOutWithout(&FilteredMotion::gyro, &flight);
  return flight;
}

std::optional<double> StandingHeight(const FlightLog& log, const std::vector<PhaseSpan>& phases,
                                     double within_m) {
  std::vector<double> heights;
  double stood_s = 0.0;
  auto next = log.odometry.begin();
  for (const PhaseSpan& span : phases) {
    if (span.phase != FlightPhase::kOff && span.phase != FlightPhase::kIdling &&
        span.phase != FlightPhase::kOnGround) {
      continue;
    }
    stood_s += ToSeconds(span.to - span.from);
    while (next != log.odometry.end() && next->stamp < span.from) ++next;
    for (; next != log.odometry.end() && next->stamp <= span.to; ++next) {
      heights.push_back(next->p_WS.z());
    }
  }
  if (heights.empty() || stood_s < kLeastStand_s) return std::nullopt;
  std::sort(heights.begin(), heights.end());
  const size_t tail = heights.size() / 20;
  if (heights[heights.size() - 1 - tail] - heights[tail] > within_m) return std::nullopt;
  return heights[heights.size() / 2];
}

void AddGroundTouches(const FlightLog& log, const std::vector<PhaseSpan>& phases,
                      const Vehicle& vehicle, StampSpans* left_out) {
  const auto stood_z = StandingHeight(log, phases, vehicle.rotors.front().radius_m);
  if (!stood_z) return;
  const Eigen::Quaterniond q_SB = vehicle.odometry.q_BS.conjugate();
  const double reach = vehicle.ArmLength() + vehicle.odometry.p_BS.norm();
  const Stamp window = FromSeconds(kFilterWidth_s);
  StampSpans touches;
  double low_s = 0.0, flown_s = 0.0;
  auto next = log.odometry.begin();
  for (const PhaseSpan& span : phases) {
    if (!Teaches(span.phase)) continue;
    flown_s += ToSeconds(span.to - span.from);
    while (next != log.odometry.end() && next->stamp < span.from) ++next;
    for (; next != log.odometry.end() && next->stamp <= span.to; ++next) {
      const Vector3d up_B = (next->q_WS * q_SB).conjugate() * Vector3d::UnitZ();
      const double lean = up_B.head<2>().norm();
      if (std::abs(next->p_WS.z() - *stood_z) > kPositionError_m + reach * lean) continue;
      const Stamp from = next->stamp - window, to = next->stamp + window;
      if (!touches.empty() && from <= touches.back().second) {
        low_s += ToSeconds(to - touches.back().second);
        touches.back().second = to;
      } else {
        low_s += ToSeconds(to - from);
        touches.emplace_back(from, to);
      }
    }
  }
  if (low_s > kFliesThere * flown_s) return;
  left_out->insert(left_out->end(), touches.begin(), touches.end());
}

Vector3d LoadForceEvaluator::PullAt(const FilteredMotion& now, const ModelValues& values,
                                    const BodyProperties* body) {
  // The filter takes its first half window; before that the vehicle stood still or was on course.
  const SensorMotion sensor{now.v_WS, now.R_WS, now.w_S};
  if (is_first_) {
    last_ = sensor;
    // Of a swing so long ago nothing is left: it begins here.
    if (now.t_s > LoadObserver::kForgotten_s) t_s_ = now.t_s - kFilterWidth_s;
    last_.v_WS -= std::min(now.t_s - t_s_, kFilterWidth_s) * now.a_WS;
  }
  is_first_ = false;
  // Through gaps with their mean acceleration, which leaves the velocity right.
  const Vector3d pull_W = load_.Advance(last_, sensor, now.t_s - t_s_, values, body).pull_W;
  last_ = sensor;
  t_s_ = now.t_s;
  return pull_W;
}

std::vector<Eigen::Vector3d> LoadPulls(const FlightMotion& flight, const DynamicModel& model,
                                       const ModelValues& values) {
  LoadForceEvaluator load(model);
  std::vector<Vector3d> pulls;
  pulls.reserve(flight.samples.size());
  std::optional<BodyProperties> body;
  if (!model.varies()) body = model.Properties(values);
  for (const FilteredMotion& now : flight.samples) {
    pulls.push_back(load.PullAt(now, values, body ? &*body : nullptr));
  }
  return pulls;
}

}  // namespace odmc
