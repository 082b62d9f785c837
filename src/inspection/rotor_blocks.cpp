#include "odmc/inspection/rotor_blocks.h"

#include <algorithm>
#include <cmath>
#include <complex>
#include <functional>
#include <limits>
#include <optional>

#include "odmc/inspection/motion_signals.h"
#include "odmc/math/so3.h"
#include "odmc/math/statistics.h"

namespace odmc {
namespace {

using Eigen::MatrixXcd;
using Eigen::MatrixXd;
using Eigen::VectorXd;
using Complex = std::complex<double>;

constexpr int kGrid = 100;  // points of a block, 10 ms apart: the bins are 1 Hz apart
constexpr double kGrid_hz = 100.0;
constexpr int kFirstBin = 2, kLastBin = 15, kFewestBins = 4;
constexpr double kMostOfRate = 0.35;  // of a stream's rate: above, interpolation eats the motion
constexpr double kLongestGap_s = 0.07;
constexpr int kMostBlocks = 300;
// Flight speeds: squared speeds sum up to more than this share of the typical block's. Standing or
// carried vehicles turn their rotors slower, as a rule; what remains is outvoted block by block.
constexpr double kFlightShare = 0.6, kTurnsShare = 0.3;

// Bands of the samples' spectrum, each the mean of three frequencies, of which the median over
// blocks of white noise is 0.891 of its mean (chi-square with six degrees of freedom).
constexpr int kBands = 8, kBandBins = 3;
constexpr double kMedianOfBand = 0.891;

/// A stream of numbers: `at` writes sample i and returns its time, false if it has none.
struct Series {
  size_t size = 0;
  int channels = 0;
  std::function<bool(size_t, double*, double*)> at;
};

/// Samples of a series around a block, one row each.
struct Stretch {
  std::vector<double> t_s;
  std::vector<double> values;
  int channels = 0;
};

void Write(const Eigen::Vector3d& v, double* out) { Eigen::Map<Eigen::Vector3d>{out} = v; }

Series GyroSeries(const FlightLog& log, const Vehicle& vehicle) {
  const Eigen::Matrix3d R_BI =
      vehicle.imu ? vehicle.imu->q_BS.toRotationMatrix() : Eigen::Matrix3d::Identity();
  return {log.imu.size(), 3, [&log, R_BI](size_t i, double* t_s, double* out) {
            if (!log.imu[i].gyro_I) return false;
            *t_s = FlightSeconds(log.imu[i].stamp, log);
            Write(R_BI * *log.imu[i].gyro_I, out);
            return true;
          }};
}

Series TwistSeries(const FlightLog& log, const Vehicle& vehicle) {
  const Eigen::Matrix3d R_BS = vehicle.odometry.q_BS.toRotationMatrix();
  return {log.odometry.size(), 3, [&log, R_BS](size_t i, double* t_s, double* out) {
            if (!log.odometry[i].w_WS_S) return false;
            *t_s = FlightSeconds(log.odometry[i].stamp, log);
            Write(R_BS * *log.odometry[i].w_WS_S, out);
            return true;
          }};
}

/// Mean rate from one attitude to the next, at the middle between them.
Series AttitudeSeries(const FlightLog& log, const Vehicle& vehicle) {
  const Eigen::Matrix3d R_BS = vehicle.odometry.q_BS.toRotationMatrix();
  return {log.odometry.size() - 1, 3, [&log, R_BS](size_t i, double* t_s, double* out) {
            const OdometrySample &a = log.odometry[i], &b = log.odometry[i + 1];
            const double step_s = ToSeconds(b.stamp - a.stamp);
            *t_s = 0.5 * (FlightSeconds(a.stamp, log) + FlightSeconds(b.stamp, log));
            Write(R_BS * Log(a.q_WS.conjugate() * b.q_WS) / step_s, out);
            return step_s > 0.0 && a.q_WS.coeffs() != b.q_WS.coeffs();
          }};
}

Series RateSeries(const FlightLog& log, const Vehicle& vehicle) {
  const auto gyros =
      std::count_if(log.imu.begin(), log.imu.end(), [](const auto& s) { return s.gyro_I; });
  if (2 * gyros > static_cast<long>(log.imu.size())) return GyroSeries(log, vehicle);
  const auto twists = std::count_if(log.odometry.begin(), log.odometry.end(),
                                    [](const auto& s) { return s.w_WS_S; });
  if (2 * twists > static_cast<long>(log.odometry.size())) return TwistSeries(log, vehicle);
  return AttitudeSeries(log, vehicle);
}

/// Squared speeds, then speeds.
Series SpeedSeries(const FlightLog& log, int n) {
  return {log.rotors.size(), 2 * n, [&log, n](size_t i, double* t_s, double* out) {
            const RotorVector& speed = log.rotors[i].speed;
            if (speed.size() != n || !speed.allFinite()) return false;
            *t_s = FlightSeconds(log.rotors[i].stamp, log);
            Eigen::Map<VectorXd>(out, n) = speed.array().square();
            Eigen::Map<VectorXd>(out + n, n) = speed;
            return true;
          }};
}

/// Median step of a series, from a share of its samples [s]; 0 if it has none.
double StepOf(const Series& series) {
  std::vector<double> steps, row(static_cast<size_t>(series.channels));
  const size_t stride = std::max<size_t>(1, series.size / 1000);
  for (size_t i = 0; i + 1 < series.size; i += stride) {
    double a = 0.0, b = 0.0;
    if (series.at(i, &a, row.data()) && series.at(i + 1, &b, row.data())) steps.push_back(b - a);
  }
  return Median(steps);
}

/// Takes the samples from just before `start_s` to just after `end_s`; `from` is where to begin to
/// look and moves on. @returns false where there is a gap
bool Take(const Series& series, double start_s, double end_s, size_t* from, Stretch* out) {
  out->t_s.clear();
  out->values.clear();
  out->channels = series.channels;
  std::vector<double> row(static_cast<size_t>(series.channels));
  for (size_t i = *from; i < series.size; ++i) {
    double t = 0.0;
    if (!series.at(i, &t, row.data())) continue;
    if (t < start_s) {
      out->t_s.clear();
      out->values.clear();
      *from = i;
    } else if (!out->t_s.empty() && t <= out->t_s.back()) {
      continue;
    }
    out->t_s.push_back(t);
    out->values.insert(out->values.end(), row.begin(), row.end());
    if (t > end_s) break;
  }
  const auto& t_s = out->t_s;
  if (t_s.size() < 3 || t_s.front() > start_s || t_s.back() < end_s) return false;
  for (size_t i = 1; i < t_s.size(); ++i) {
    if (t_s[i] - t_s[i - 1] > kLongestGap_s) return false;
  }
  return true;
}

/// Integral of the straight lines between samples, from the first one, at rising times.
class Integral {
 public:
  explicit Integral(const Stretch& stretch) : s_(stretch), sum_(VectorXd::Zero(stretch.channels)) {}

  VectorXd At(double t_s) {
    while (k_ + 2 < s_.t_s.size() && s_.t_s[k_ + 1] < t_s) {
      sum_ += 0.5 * (s_.t_s[k_ + 1] - s_.t_s[k_]) * (Row(k_) + Row(k_ + 1));
      ++k_;
    }
    const double h = t_s - s_.t_s[k_], span = s_.t_s[k_ + 1] - s_.t_s[k_];
    return sum_ + h * (Row(k_) + 0.5 * h / span * (Row(k_ + 1) - Row(k_)));
  }

 private:
  Eigen::Map<const VectorXd> Row(size_t k) const {
    return {s_.values.data() + k * static_cast<size_t>(s_.channels), s_.channels};
  }

  const Stretch& s_;
  VectorXd sum_;
  size_t k_ = 0;
};

/// Means over 10 ms, kGrid×channels.
MatrixXd Average(const Stretch& stretch, double start_s) {
  MatrixXd grid(kGrid, stretch.channels);
  Integral integral(stretch);
  VectorXd before = integral.At(start_s);
  for (int i = 0; i < kGrid; ++i) {
    const VectorXd after = integral.At(start_s + (i + 1) / kGrid_hz);
    grid.row(i) = kGrid_hz * (after - before).transpose();
    before = after;
  }
  return grid;
}

/// Fourier sums over a block under a Hann window, and under the window's derivative.
struct Transform {
  std::vector<double> omega;
  MatrixXcd tapered, slope;  // bins×kGrid

  explicit Transform(int last_bin) {
    const int bins = last_bin - kFirstBin + 1;
    tapered.resize(bins, kGrid);
    slope.resize(bins, kGrid);
    for (int k = 0; k < bins; ++k) {
      omega.push_back(2.0 * M_PI * (kFirstBin + k) * kGrid_hz / kGrid);
      for (int i = 0; i < kGrid; ++i) {
        const double x = 2.0 * M_PI * (i + 0.5) / kGrid;
        const Complex turn = std::polar(1.0, -omega.back() * (i + 0.5) / kGrid_hz);
        tapered(k, i) = 0.5 * (1.0 - std::cos(x)) * turn;
        slope(k, i) = 0.5 * 2.0 * M_PI * kGrid_hz / kGrid * std::sin(x) * turn;
      }
    }
  }

  MatrixXcd Of(const MatrixXd& grid) const { return tapered * grid; }

  /// Of the derivative: by parts, window times dx/dt = d(window x)/dt - d(window)/dt x.
  MatrixXcd OfDerivative(const MatrixXd& grid) const {
    MatrixXcd result = tapered * grid;
    for (Eigen::Index k = 0; k < result.rows(); ++k) {
      result.row(k) *= Complex(0.0, omega[static_cast<size_t>(k)]);
    }
    return result - slope * grid;
  }
};

/// Power of the samples' spectrum in bands up to half of their rate, bands×n; empty for too few.
MatrixXd SamplePower(const Stretch& speeds) {
  const auto m = static_cast<Eigen::Index>(speeds.t_s.size());
  const int n = speeds.channels / 2;
  if (m < 2L * kBands) return {};
  using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  const MatrixXd speed =
      Eigen::Map<const Rows>(speeds.values.data(), m, speeds.channels).rightCols(n);
  const MatrixXd moved = speed.rowwise() - speed.colwise().mean();
  MatrixXd power = MatrixXd::Zero(kBands, n);
  Eigen::VectorXcd wave(m);
  for (int k = 0; k < kBands * kBandBins; ++k) {
    const double turn = M_PI * (k + 0.5) / (kBands * kBandBins);  // per sample
    for (Eigen::Index i = 0; i < m; ++i) {
      const double window =
          1.0 - std::cos(2.0 * M_PI * (static_cast<double>(i) + 0.5) / static_cast<double>(m));
      wave[i] = std::polar(window, -turn * static_cast<double>(i));
    }
    const MatrixXcd sums = wave.transpose() * moved;
    power.row(k / kBandBins) += sums.cwiseAbs2() / wave.squaredNorm() / kBandBins;
  }
  return power;
}

double Sinc(double x) { return x == 0.0 ? 1.0 : std::sin(M_PI * x) / (M_PI * x); }

/// Power that white noise of variance one of samples `step_s` apart has in a bin: straight lines
/// between samples, means over 10 ms, Hann window; what is beyond half of the grid's rate folds.
double WhiteInBin(double frequency_hz, double step_s) {
  double power = 0.0;
  for (int fold = -3; fold <= 3; ++fold) {
    const double f = frequency_hz + fold * kGrid_hz;
    power += step_s * std::pow(Sinc(f / kGrid_hz), 2) * std::pow(Sinc(f * step_s), 4);
  }
  constexpr double kHannSquared = 0.375;  // mean of the squared window
  return kHannSquared * kGrid * kGrid_hz * power;
}

/// @param step_s between rotor samples
void FindNoise(double step_s, RotorBlocks* all) {
  const auto bins = static_cast<Eigen::Index>(all->omega.size());
  const Eigen::Index n = all->blocks.empty() ? 0 : all->blocks.front().mean_squared.size();
  all->noise = MatrixXd::Zero(bins, n);
  for (Eigen::Index j = 0; j < n; ++j) {
    double variance = std::numeric_limits<double>::infinity();
    for (int band = 0; band < kBands; ++band) {
      std::vector<double> powers;
      for (const RotorBlock& block : all->blocks) {
        if (block.sample_power.size() > 0) powers.push_back(block.sample_power(band, j));
      }
      // The median over blocks: a crash must not be noise.
      variance = std::min(variance, powers.empty() ? 0.0 : Median(powers) / kMedianOfBand);
    }
    std::vector<double> squared;
    for (const RotorBlock& block : all->blocks) squared.push_back(block.mean_squared[j]);
    for (Eigen::Index k = 0; k < bins; ++k) {
      all->noise(k, j) = 4.0 * Median(squared) * variance *
                         WhiteInBin(all->omega[static_cast<size_t>(k)] / (2.0 * M_PI), step_s);
    }
  }
}

MatrixXd WithoutMean(const MatrixXd& grid) { return grid.rowwise() - grid.colwise().mean(); }

RotorBlock BlockOf(const Stretch& rates, const Stretch& speeds, double start_s,
                   const Transform& transform) {
  const int n = speeds.channels / 2;
  const MatrixXd rate = WithoutMean(Average(rates, start_s)), speed = Average(speeds, start_s);
  const MatrixXd moved = WithoutMean(speed);
  RotorBlock block;
  block.start_s = start_s;
  block.turn = transform.OfDerivative(rate);
  block.squared = transform.Of(moved.leftCols(n));
  block.spin_up = transform.OfDerivative(moved.rightCols(n));
  block.mean_squared = speed.leftCols(n).colwise().mean().transpose();
  block.sample_power = SamplePower(speeds);
  return block;
}

void KeepFlying(std::vector<RotorBlock>* blocks) {
  std::vector<double> sums, turning;
  for (const RotorBlock& b : *blocks) sums.push_back(b.mean_squared.sum());
  const double high = Quantile(sums, 0.95);
  for (const double sum : sums) {
    if (sum > kTurnsShare * high) turning.push_back(sum);
  }
  const double least = kFlightShare * Median(turning);
  const auto flies = [least](const RotorBlock& b) { return b.mean_squared.sum() > least; };
  blocks->erase(std::remove_if(blocks->begin(), blocks->end(), std::not_fn(flies)), blocks->end());
}

}  // namespace

RotorBlocks CutRotorBlocks(const FlightLog& log, const Vehicle& vehicle) {
  RotorBlocks result;
  if (log.odometry.size() < 3 || log.rotors.size() < 3 || log.rotor_rms_only) return result;
  const Series rates = RateSeries(log, vehicle), speeds = SpeedSeries(log, vehicle.num_rotors());
  const double step_s = std::max(StepOf(rates), StepOf(speeds));
  if (!(step_s > 0.0)) return result;
  const int last_bin = std::min(kLastBin, static_cast<int>(kMostOfRate / step_s));
  if (last_bin - kFirstBin + 1 < kFewestBins) return result;
  const Transform transform(last_bin);
  result.omega = transform.omega;
  const double length_s = kGrid / kGrid_hz, hop_s = 0.5 * length_s;
  const double begin_s = std::max(0.0, FlightSeconds(log.rotors.front().stamp, log));
  const double end_s = std::min(FlightSeconds(log.odometry.back().stamp, log),
                                FlightSeconds(log.rotors.back().stamp, log));
  const double stride_s = hop_s * std::max(1.0, std::ceil((end_s - begin_s) / hop_s / kMostBlocks));
  // A minute on the ground must not outvote ten seconds of flight.
  const std::optional<MotionSignals> signals = SignalsOf(log);
  if (!signals) return result;
  const std::vector<bool> flight = FindFlight(*signals);
  size_t rate = 0, speed = 0;
  Stretch rate_stretch, speed_stretch;
  for (double start_s = begin_s; start_s + length_s <= end_s; start_s += stride_s) {
    const bool whole = Take(rates, start_s, start_s + length_s, &rate, &rate_stretch);
    if (!IsInFlight(flight, start_s + 0.5 * length_s)) continue;
    if (!Take(speeds, start_s, start_s + length_s, &speed, &speed_stretch) || !whole) continue;
    result.blocks.push_back(BlockOf(rate_stretch, speed_stretch, start_s, transform));
  }
  KeepFlying(&result.blocks);
  FindNoise(StepOf(speeds), &result);
  return result;
}

}  // namespace odmc
