#include "odmc/inspection/join_odometry.h"

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <complex>
#include <limits>
#include <stdexcept>
#include <unsupported/Eigen/FFT>

#include "odmc/inspection/motion_signals.h"
#include "odmc/inspection/time_offsets.h"
#include "odmc/math/so3.h"
#include "odmc/sensing/flight_checks.h"
#include "odmc/text/format.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

using Eigen::Matrix3Xd;
using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;

constexpr double kStep_s = 0.05, kWidth_s = 0.1;
constexpr double kLeastOverlap_s = 5.0;
constexpr double kLeastShare = 0.2;  // of the shorter recording, that must overlap
constexpr int kCandidates = 40;
constexpr double kApart_s = 0.3;  // nearer places are the same one
// Of the rates' variance: two recordings of different flights explain a tenth of each other at the
// best of all offsets.
constexpr double kLeastExplained = 0.5;
// Nats that the best place must have over the next, with one independent sample a second: the wrong
// one of two would be taken once in 150 recordings.
constexpr double kLeastNats = 5.0;

/// Rates on an even grid; columns that are not usable are zero.
struct GridRates {
  double first_s = 0.0;
  Matrix3Xd rates;
  VectorXd usable;  // 1 or 0

  Eigen::Index size() const { return usable.size(); }
};

template <typename Rate>
GridRates OnGrid(const SampledSignal& signal, double width_s, Rate rate) {
  GridRates grid;
  grid.first_s = signal.first_s() + 0.5 * width_s;
  const auto n = static_cast<Eigen::Index>(
      std::max(0.0, (signal.last_s() - signal.first_s() - width_s) / kStep_s));
  grid.rates = Matrix3Xd::Zero(3, n);
  grid.usable = VectorXd::Zero(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const double t = grid.first_s + static_cast<double>(i) * kStep_s;
    if (!signal.Covers(t - 0.5 * width_s, t + 0.5 * width_s)) continue;
    grid.rates.col(i) = rate(t - 0.5 * width_s, t + 0.5 * width_s);
    grid.usable[i] = 1.0;
  }
  return grid;
}

/// Sums of a[i] b[i + shift] over i, for all shifts: entry k is that of shift k - (size of a - 1).
class Correlator {
 public:
  Correlator(Eigen::Index size_a, Eigen::Index size_b) : size_a_(size_a), size_b_(size_b) {
    while (length_ < size_a + size_b) length_ *= 2;
  }

  VectorXd operator()(const VectorXd& a, const VectorXd& b) {
    const std::vector<std::complex<double>> in_a = Transformed(a.reverse()), in_b = Transformed(b);
    std::vector<std::complex<double>> product(in_a.size());
    for (size_t i = 0; i < product.size(); ++i) product[i] = in_a[i] * in_b[i];
    std::vector<std::complex<double>> sums;
    fft_.inv(sums, product);
    VectorXd result(size_a_ + size_b_ - 1);
    for (Eigen::Index i = 0; i < result.size(); ++i)
      result[i] = sums[static_cast<size_t>(i)].real();
    return result;
  }

 private:
  std::vector<std::complex<double>> Transformed(const VectorXd& values) {
    std::vector<std::complex<double>> padded(static_cast<size_t>(length_)), spectrum;
    for (Eigen::Index i = 0; i < values.size(); ++i) padded[static_cast<size_t>(i)] = values[i];
    fft_.fwd(spectrum, padded);
    return spectrum;
  }

  Eigen::Index size_a_, size_b_, length_ = 1;
  Eigen::FFT<double> fft_;
};

/// Likelihood gained over no relation by the correlation of the speeds of turning, for every shift
/// of the poses' grid against the gyro's [nats]; 0 where they overlap too little or turn against
/// each other.
VectorXd SpeedGains(const GridRates& poses, const GridRates& gyro) {
  const VectorXd x = poses.rates.colwise().norm().transpose(),
                 y = gyro.rates.colwise().norm().transpose();
  Correlator correlate(poses.size(), gyro.size());
  const VectorXd n = correlate(poses.usable, gyro.usable), sx = correlate(x, gyro.usable),
                 sy = correlate(poses.usable, y), sxx = correlate(x.cwiseAbs2(), gyro.usable),
                 syy = correlate(poses.usable, y.cwiseAbs2()), sxy = correlate(x, y);
  const double least = std::max(kLeastOverlap_s / kStep_s,
                                kLeastShare * std::min(poses.usable.sum(), gyro.usable.sum()));
  VectorXd gains = VectorXd::Zero(n.size());
  for (Eigen::Index k = 0; k < n.size(); ++k) {
    if (n[k] < least) continue;
    const double vx = sxx[k] - sx[k] * sx[k] / n[k], vy = syy[k] - sy[k] * sy[k] / n[k];
    const double c = sxy[k] - sx[k] * sy[k] / n[k];
    if (!(vx > 0.0) || !(vy > 0.0) || !(c > 0.0)) continue;
    const double r2 = std::min(c * c / (vx * vy), 1.0 - 1e-9);
    gains[k] = -0.5 * n[k] * std::log(1.0 - r2);
  }
  return gains;
}

/// The shifts with the highest gains, apart from each other.
std::vector<Eigen::Index> Peaks(VectorXd gains) {
  const auto apart = static_cast<Eigen::Index>(kApart_s / kStep_s);
  std::vector<Eigen::Index> peaks;
  while (static_cast<int>(peaks.size()) < kCandidates) {
    Eigen::Index best = 0;
    if (gains.size() == 0 || gains.maxCoeff(&best) <= 0.0) break;
    peaks.push_back(best);
    const Eigen::Index from = std::max<Eigen::Index>(0, best - apart);
    gains.segment(from, std::min(gains.size(), best + apart + 1) - from).setZero();
  }
  return peaks;
}

/// How well the gyro explains the poses' rates at one shift, by a free matrix and a bias.
struct Match {
  Eigen::Index shift = 0;  // index of the gyro's grid minus that of the poses'
  double explained = 0.0, nats = 0.0;
};

Match MatchAt(const GridRates& poses, const GridRates& gyro, Eigen::Index shift) {
  Eigen::Matrix4d xx = Eigen::Matrix4d::Zero();
  Eigen::Matrix<double, 4, 3> xy = Eigen::Matrix<double, 4, 3>::Zero();
  Vector3d sum = Vector3d::Zero();
  double yy = 0.0, n = 0.0;
  for (Eigen::Index i = std::max<Eigen::Index>(0, -shift);
       i < std::min(poses.size(), gyro.size() - shift); ++i) {
    if (poses.usable[i] * gyro.usable[i + shift] == 0.0) continue;
    Eigen::Vector4d x;
    x << gyro.rates.col(i + shift), 1.0;
    const Vector3d y = poses.rates.col(i);
    xx += x * x.transpose();
    xy += x * y.transpose();
    sum += y;
    yy += y.squaredNorm();
    n += 1.0;
  }
  Match match;
  match.shift = shift;
  const double total = yy - sum.squaredNorm() / std::max(n, 1.0);
  if (n < kLeastOverlap_s / kStep_s || !(total > 0.0)) return match;
  const Eigen::Matrix<double, 4, 3> b = xx.ldlt().solve(xy);
  const double left = std::max(yy - (b.array() * xy.array()).sum(), 1e-12 * total);
  match.explained = 1.0 - left / total;
  match.nats = -0.5 * n * kStep_s * std::log(left / total);
  return match;
}

/// The shift that fits best, to the grid and its neighbours.
Match FindMatch(const GridRates& poses, const GridRates& gyro) {
  std::vector<Match> matches;
  for (const Eigen::Index peak : Peaks(SpeedGains(poses, gyro))) {
    Match best;
    for (Eigen::Index near = -2; near <= 2; ++near) {
      const Match match = MatchAt(poses, gyro, peak - (poses.size() - 1) + near);
      if (match.nats > best.nats) best = match;
    }
    matches.push_back(best);
  }
  std::sort(matches.begin(), matches.end(),
            [](const Match& a, const Match& b) { return a.nats > b.nats; });
  if (matches.empty() || matches.front().explained < kLeastExplained) {
    throw std::invalid_argument(
        Format("the gyro explains %.0f %% of the poses' rates at best: they are not of one "
               "flight, or hardly turn together",
               matches.empty() ? 0.0 : 100.0 * std::max(0.0, matches.front().explained)));
  }
  const auto apart = static_cast<Eigen::Index>(kApart_s / kStep_s);
  for (const Match& other : matches) {
    if (std::abs(other.shift - matches.front().shift) <= apart) continue;
    if (matches.front().nats - other.nats >= kLeastNats) break;
    throw std::invalid_argument(
        "several offsets fit alike, the motion repeats itself: turn the vehicle by hand once "
        "before take-off");
  }
  return matches.front();
}

std::vector<OdometrySample> Shifted(std::vector<OdometrySample> poses, Stamp shift) {
  for (OdometrySample& sample : poses) sample.stamp += shift;
  return poses;
}

std::optional<SampledSignal> GyroSignal(const std::vector<ImuSample>& imu) {
  std::vector<double> t_s;
  for (const ImuSample& s : imu) {
    if (s.gyro_I) t_s.push_back(ToSeconds(s.stamp - imu.front().stamp));
  }
  if (t_s.size() < 5 || t_s.back() - t_s.front() < kLeastOverlap_s) return std::nullopt;
  MatrixXd values(3, static_cast<Eigen::Index>(t_s.size()));
  Eigen::Index i = 0;
  for (const ImuSample& s : imu) {
    if (s.gyro_I) values.col(i++) = *s.gyro_I;
  }
  return SampledSignal(std::move(t_s), std::move(values));
}

/// Poses as x, y, z, w with continuous sign; those that repeat the one before are left out.
SampledSignal AttitudeSignal(const std::vector<OdometrySample>& poses) {
  std::vector<double> t_s;
  std::vector<Eigen::Vector4d> turns;
  for (const OdometrySample& s : poses) {
    Eigen::Vector4d q = s.q_WS.coeffs();
    if (!turns.empty() && q.dot(turns.back()) < 0.0) q = -q;
    if (!turns.empty() && q == turns.back()) continue;
    t_s.push_back(ToSeconds(s.stamp - poses.front().stamp));
    turns.push_back(q);
  }
  MatrixXd values(4, static_cast<Eigen::Index>(turns.size()));
  for (size_t i = 0; i < turns.size(); ++i) values.col(static_cast<Eigen::Index>(i)) = turns[i];
  return SampledSignal(std::move(t_s), std::move(values));
}

/// Offset to the grid's step.
Match CoarseOffset(const SampledSignal& gyro, const SampledSignal& attitude, double* offset_s) {
  const double width_s = std::max({kWidth_s, 2.0 * attitude.step_s(), 2.0 * gyro.step_s()});
  const auto q = [&](double t) {
    return Eigen::Quaterniond(Eigen::Vector4d(attitude.At(t).normalized()));
  };
  const GridRates turns = OnGrid(attitude, width_s, [&](double from, double to) -> Vector3d {
    return Log(q(from).conjugate() * q(to)) / (to - from);
  });
  const GridRates rates = OnGrid(
      gyro, width_s, [&](double from, double to) -> Vector3d { return gyro.Mean(from, to); });
  const Match match = FindMatch(turns, rates);
  *offset_s = rates.first_s - turns.first_s + static_cast<double>(match.shift) * kStep_s;
  return match;
}

/// Sigma of a lag by leaving out one stretch of the flight after the other (delete-a-group
/// jackknife): what noise of the poses, lines between them and drift of the clocks do is in it,
/// whatever the blocks of the regression say.
double JackknifeSigma(const MotionSignals& signals, size_t steps) {
  constexpr size_t kStretches = 8;
  std::vector<double> lags;
  for (size_t k = 0; k < kStretches; ++k) {
    std::vector<bool> kept(steps, true);
    for (size_t i = k * steps / kStretches; i < (k + 1) * steps / kStretches; ++i) kept[i] = false;
    const std::optional<TimeOffset> offset = GyroOffset(signals, kept);
    if (offset) lags.push_back(offset->lag.lag_s);
  }
  const auto n = static_cast<double>(lags.size());
  double mean = 0.0, square = 0.0;
  for (const double lag : lags) mean += lag / n;
  for (const double lag : lags) square += (lag - mean) * (lag - mean);
  return std::sqrt((n - 1.0) / std::max(n, 1.0) * square);
}

}  // namespace

ClockOffset FindClockOffset(const std::vector<ImuSample>& imu,
                            const std::vector<OdometrySample>& poses) {
  const std::optional<SampledSignal> gyro = GyroSignal(imu);
  if (!gyro) throw std::invalid_argument("there is no gyro, or less than 5 s of it");
  if (poses.size() < 10) throw std::invalid_argument("there are fewer than 10 poses");
  double coarse_s = 0.0;
  const Match match = CoarseOffset(*gyro, AttitudeSignal(poses), &coarse_s);
  // Seconds of either clock since its first sample: the rest is exact.
  const Stamp shift = imu.front().stamp - poses.front().stamp + FromSeconds(coarse_s);
  FlightLog pair;
  pair.odometry = Shifted(poses, shift);
  pair.imu = imu;
  const Stamp from = imu.front().stamp, to = imu.back().stamp;
  auto& kept = pair.odometry;
  kept.erase(std::remove_if(kept.begin(), kept.end(),
                            [&](const auto& s) { return s.stamp < from || s.stamp > to; }),
             kept.end());
  const std::optional<MotionSignals> signals = SignalsOf(pair);
  if (!signals) throw std::invalid_argument("there are fewer than 5 different poses");
  const std::vector<bool> all(static_cast<size_t>(signals->position.last_s() / kFlightStep_s) + 1,
                              true);
  const std::optional<TimeOffset> fine = GyroOffset(*signals, all);
  if (!fine || !fine->lag.determined()) {
    throw std::invalid_argument("the motion does not tell the offset of their clocks");
  }
  // The gyro's stamps are late by the lag against poses: these are to follow.
  return {ToSeconds(shift) + fine->lag.lag_s,
          std::max(fine->lag.sigma_s(), JackknifeSigma(*signals, all.size())), match.explained};
}

void JoinOdometry(const FlightLog& poses, std::optional<double> offset_s, FlightLog* log) {
  const bool had_poses = !log->odometry.empty();
  UseMocapPoses({}, log);  // the log's own poses go, their body rates replace a gyro
  std::optional<ClockOffset> found;
  if (!offset_s) {
    try {
      found = FindClockOffset(log->imu, poses.odometry);
    } catch (const std::invalid_argument& e) {
      throw std::invalid_argument(log->file + " and the poses of " + poses.file + ": " + e.what() +
                                  "; --odometry-offset S says what is to be added to the stamps of "
                                  "the poses");
    }
    offset_s = found->offset_s;
  }
  log->odometry = Shifted(poses.odometry, FromSeconds(*offset_s));
  Stamp from = std::numeric_limits<Stamp>::max(), to = std::numeric_limits<Stamp>::min();
  const auto widen = [&](const auto& samples) {
    if (samples.empty()) return;
    from = std::min(from, samples.front().stamp);
    to = std::max(to, samples.back().stamp);
  };
  widen(log->imu);
  widen(log->rotors);
  widen(log->commands);
  auto& kept = log->odometry;
  kept.erase(std::remove_if(kept.begin(), kept.end(),
                            [&](const auto& s) { return s.stamp < from || s.stamp > to; }),
             kept.end());
  if (kept.empty()) {
    RefuseFile(log->file, "with an offset of " + std::to_string(*offset_s) + " s no pose of " +
                              poses.file + " is within the log");
  }
  log->dropped += poses.dropped;
  log->warnings.insert(log->warnings.end(), poses.warnings.begin(), poses.warnings.end());
  std::string text;
  if (found) {
    text = Format(
        ": %zu of %zu poses, %s%.6f s added to their stamps (sigma %.2f ms; the gyro "
        "explains %.1f %% of their rates)",
        kept.size(), poses.odometry.size(), had_poses ? "in place of the log's own, " : "",
        *offset_s, 1e3 * found->sigma_s, 100.0 * found->explained);
  } else {
    text = Format(": %zu of %zu poses, %s%.6f s added to their stamps as told", kept.size(),
                  poses.odometry.size(), had_poses ? "in place of the log's own, " : "", *offset_s);
  }
  log->warnings.push_back(poses.file + text);
}

}  // namespace odmc
