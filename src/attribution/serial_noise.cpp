#include "odmc/attribution/serial_noise.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace odmc {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr double kAveraged = 40.0;  // values of which a spectrum's ordinate is the mean: to 22 %
// Corners below which the noise of a derivative is no longer less, by the flight's length: thirty
// cycles tell to 18 % how small it is, fewer hardly do. Above the highest the order 8 holds the
// spectrum.
constexpr double kFloorCycles[] = {30.0, 60.0, 120.0};
constexpr double kHighestFloor_Hz = 3.0;
// The slow factor: corners of its pole, below what FitOrder8() resolves, and by how much the power
// of noise at zero frequency is above what that says. A short flight hardly tells: about the same
// is likely, a factor of eight one sigma away. Never below it: few cycles may be small by chance.
constexpr double kCorners_Hz[] = {0.03, 0.1, 0.3};
constexpr double kExcesses[] = {1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0};
constexpr double kExcessSigma = 2.0794;  // of its logarithm: log(8)

/// Predicts x[k] = pole x[k-1] + w[k] - zero w[k-1], w being white of unit variance, sample by
/// sample: h is what the past tells of the next x (Kalman filter; Brockwell and Davis, Time Series:
/// Theory and Methods, 1991, ch. 12).
template <typename Row>
class SlowFilter {
 public:
  SlowFilter(double pole, double zero, Row nothing)
      : pole_(pole),
        zero_(zero),
        stationary_((pole - zero) * (pole - zero) / (1.0 - pole * pole)),
        P_(stationary_),
        h_(std::move(nothing)) {}

  /// Time that passes without samples before the k-th of `rows`.
  void SkipBetween(const std::vector<int>& rows, Index k) {
    const auto row = static_cast<size_t>(k);
    const int samples = row > 0 ? rows[row] - rows[row - 1] - 1 : 0;
    if (samples == 0) return;
    const double decay = std::pow(pole_, samples);
    h_ *= decay;
    P_ = stationary_ + decay * decay * (P_ - stationary_);
  }

  /// Innovation of the next sample, of variance() as it was before.
  template <typename Sample>
  Row Next(const Sample& x) {
    const double d = pole_ - zero_, S = variance(), K = (pole_ * P_ + d) / S;
    Row innovation = x - h_;
    h_ = pole_ * h_ + K * innovation;
    P_ = std::max(0.0, pole_ * pole_ * P_ + d * d - K * K * S);
    return innovation;
  }
  /// Of the next innovation; 1 after a long past.
  double variance() const { return 1.0 + P_; }

 private:
  double pole_, zero_;
  double stationary_;  // variance of h that nothing tells
  double P_;           // and of its error
  Row h_;
};

}  // namespace

SerialNoise SerialNoise::Fit(const MatrixXd& e, const std::vector<int>& rows, double step_s,
                             bool with_derivative, bool with_slow) {
  SerialNoise noise;
  if (with_derivative) {
    noise.FitDerivative(e, rows, step_s);
  } else {
    noise.FitOrder8(e, rows, step_s);
  }
  if (with_slow || noise.derivative_zero_ > 0.0) noise.FitSlow(e, rows, step_s);
  return noise;
}

void SerialNoise::FitDerivative(const MatrixXd& e, const std::vector<int>& rows, double step_s) {
  const auto log_likelihood = [&](const SerialNoise& noise) {
    const double n = static_cast<double>(rows.size());
    const double square = noise.WithoutOrder8(noise.WithoutDerivative(e, rows), rows).squaredNorm();
    return -0.5 * n * std::log(std::max(square, 1e-300));
  };
  SerialNoise best = *this;
  best.FitOrder8(e, rows, step_s);
  double most = log_likelihood(best);
  for (const double cycles : kFloorCycles) {
    const double floor_Hz = cycles / (static_cast<double>(rows.size()) * step_s);
    if (floor_Hz > kHighestFloor_Hz) break;
    SerialNoise noise = *this;
    noise.derivative_zero_ = std::exp(-2.0 * M_PI * floor_Hz * step_s);
    noise.FitOrder8(noise.WithoutDerivative(e, rows), rows, step_s);
    const double likelihood = log_likelihood(noise);
    if (likelihood <= most) continue;
    most = likelihood;
    best = noise;
  }
  *this = best;
}

void SerialNoise::FitOrder8(const MatrixXd& e, const std::vector<int>& rows, double step_s) {
  using Moments = Eigen::Matrix<double, kOrder + 1, kOrder + 1>;
  Moments S = Moments::Zero();  // of a sample, first, and its predecessors
  const MatrixXd by_sample = e.transpose();
  for (const int i : rows) {
    const auto past = by_sample.middleCols<kOrder + 1>(i - kOrder).rowwise().reverse();
    S.noalias() += past.transpose().lazyProduct(past);
  }
  // A short flight's spectrum to a resolution at which an ordinate is the mean of many values. A
  // finer one takes the few cycles of a manoeuvre, and with them all that follows it, for noise
  // (Blackman and Tukey, The Measurement of Power Spectra, 1958; a Gaussian window).
  const double bandwidth_Hz = 0.5 * kAveraged / (static_cast<double>(rows.size()) * step_s);
  const double sigma_rad = std::sqrt(M_PI) * bandwidth_Hz * step_s;
  for (int i = 0; i <= kOrder; ++i) {
    for (int k = 0; k <= kOrder; ++k) S(i, k) *= std::exp(-0.5 * std::pow(sigma_rad * (i - k), 2));
  }
  Moments A = S;
  A.diagonal().array() += 1e-3 * A.diagonal().maxCoeff() + 1e-300;
  coefficients_ =
      A.bottomRightCorner<kOrder, kOrder>().ldlt().solve(S.bottomLeftCorner<kOrder, 1>());
  Eigen::Matrix<double, kOrder + 1, 1> innovation;
  innovation << 1.0, -coefficients_;
  variance_ = std::max(innovation.dot(S * innovation) / static_cast<double>(rows.size()), 1e-300);
}

void SerialNoise::FitSlow(const MatrixXd& e, const std::vector<int>& rows, double step_s) {
  const auto n = static_cast<Index>(rows.size());
  if (n == 0) return;
  // K × rows: by samples
  const MatrixXd left = WithoutOrder8(WithoutDerivative(e, rows), rows).transpose();
  double best = -std::numeric_limits<double>::infinity();
  for (const double corner_Hz : kCorners_Hz) {
    const double pole = std::exp(-2.0 * M_PI * corner_Hz * step_s);
    for (const double excess : kExcesses) {
      const double zero = 1.0 - (1.0 - pole) * std::sqrt(excess);
      SlowFilter<VectorXd> filter(pole, zero, VectorXd::Zero(left.rows()));
      double sum = 0.0, log_det = 0.0;
      for (Index k = 0; k < n; ++k) {
        filter.SkipBetween(rows, k);
        const double S = filter.variance();
        sum += filter.Next(left.col(k)).squaredNorm() / S;
        log_det += std::log(S);
      }
      // At its best variance, and by the prior of the excess.
      const double variance = std::max(sum / static_cast<double>(n), 1e-300);
      const double sigmas = std::log(excess) / kExcessSigma;
      const double log_posterior =
          -0.5 * (static_cast<double>(n) * std::log(variance) + log_det + sigmas * sigmas);
      if (log_posterior <= best) continue;
      best = log_posterior;
      slow_ = {pole, zero};
      variance_ = variance;
    }
  }
}

MatrixXd SerialNoise::WithoutDerivative(const Eigen::Ref<const MatrixXd>& e,
                                        const std::vector<int>& rows) const {
  if (derivative_zero_ == 0.0) return e;
  const double zero = derivative_zero_;
  MatrixXd before = MatrixXd::Zero(e.rows(), e.cols());
  for (Index c = 0; c < e.cols(); ++c) {
    // x[i] = w[i] - zero w[i-1]; variance is that of the innovation, 1 after a long past.
    double variance = 1.0, expected = 0.0;
    for (size_t k = 0; k < rows.size(); ++k) {
      const bool begins = k == 0 || rows[k] - rows[k - 1] > 1;
      if (begins) {
        variance = 1.0 + zero * zero;
        expected = 0.0;
      }
      for (int i = begins ? rows[k] - kOrder : rows[k]; i <= rows[k]; ++i) {
        const double innovation = e(i, c) - expected;
        before(i, c) = innovation / std::sqrt(variance);
        expected = -zero / variance * innovation;
        variance = 1.0 + zero * zero * (1.0 - 1.0 / variance);
      }
    }
  }
  return before;
}

MatrixXd SerialNoise::WithoutOrder8(const Eigen::Ref<const MatrixXd>& e,
                                    const std::vector<int>& rows) const {
  MatrixXd left(static_cast<Index>(rows.size()), e.cols());
  for (Index c = 0; c < e.cols(); ++c) {
    for (Index k = 0; k < left.rows(); ++k) {
      const int i = rows[static_cast<size_t>(k)];
      double value = e(i, c);
      for (int lag = 0; lag < kOrder; ++lag) value -= coefficients_[lag] * e(i - 1 - lag, c);
      left(k, c) = value;
    }
  }
  return left;
}

VectorXd SerialNoise::Whiten(const Eigen::Ref<const VectorXd>& x,
                             const std::vector<int>& rows) const {
  VectorXd white = WithoutOrder8(WithoutDerivative(x, rows), rows);
  SlowFilter<double> filter(slow_.pole, slow_.zero, 0.0);
  for (Index k = 0; k < white.size(); ++k) {
    filter.SkipBetween(rows, k);
    const double scale = 1.0 / std::sqrt(variance_ * filter.variance());
    white[k] = scale * filter.Next(white[k]);
  }
  return white;
}

}  // namespace odmc
