#include "odmc/attribution/regression.h"

#include <Eigen/Cholesky>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <map>

namespace odmc {
namespace {

constexpr int kOrder = 8;  // of the noise
constexpr int kRounds = 3;
constexpr int kFolds = 6;
constexpr double kLargestLeverage = 1.0;
constexpr double kWildSigmas = 5.0;  // innovations beyond count as this many

using Channel = Eigen::MatrixXd;  // whitened: rows × (n + 1), the last column is y

struct Noise {
  Eigen::VectorXd coefficients = Eigen::VectorXd::Zero(kOrder);
  double variance = 1.0;
};

/// Samples whose `kOrder` predecessors are there and in use.
std::vector<int> RowsInUse(const WrenchRegression& r) {
  std::vector<int> rows;
  int run = 0;
  for (int i = 0; i < r.y.rows(); ++i) {
    run = r.used[i] ? (r.next[i] ? run + 1 : 1) : 0;
    if (run > kOrder) rows.push_back(i);
  }
  return rows;
}

/// Autoregressive noise of a residual, by least squares.
Noise FitNoise(const Eigen::VectorXd& e, const std::vector<int>& rows) {
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(kOrder, kOrder);
  Eigen::VectorXd b = Eigen::VectorXd::Zero(kOrder);
  for (const int i : rows) {
    Eigen::VectorXd past(kOrder);
    for (int k = 0; k < kOrder; ++k) past[k] = e[i - 1 - k];
    A += past * past.transpose();
    b += e[i] * past;
  }
  A.diagonal().array() += 1e-3 * A.diagonal().maxCoeff() + 1e-300;
  Noise noise;
  noise.coefficients = A.ldlt().solve(b);
  std::vector<double> squares;
  for (const int i : rows) {
    double innovation = e[i];
    for (int k = 0; k < kOrder; ++k) innovation -= noise.coefficients[k] * e[i - 1 - k];
    squares.push_back(innovation * innovation);
  }
  double sum = 0.0;
  for (const double s : squares) sum += s;
  noise.variance = std::max(sum / static_cast<double>(rows.size()), 1e-300);
  return noise;
}

/// Rows of one channel with the noise's correlation and size taken out.
Channel Whiten(const WrenchRegression& r, int channel, const Noise& noise,
               const std::vector<int>& rows) {
  const int n = static_cast<int>(r.prior_sigma.size());
  Channel white(static_cast<int>(rows.size()), n + 1);
  const double scale = 1.0 / std::sqrt(noise.variance);
  for (size_t k = 0; k < rows.size(); ++k) {
    const int i = rows[k];
    white.row(k).head(n) = r.columns[channel].row(i);
    white(k, n) = r.y(i, channel);
    for (int lag = 0; lag < kOrder; ++lag) {
      white.row(k).head(n) -= noise.coefficients[lag] * r.columns[channel].row(i - 1 - lag);
      white(k, n) -= noise.coefficients[lag] * r.y(i - 1 - lag, channel);
    }
    white.row(k) *= scale;
  }
  return white;
}

/// Fits with white noise, the size of each channel from the fit itself; for the mean squares,
/// leaves one fold out at a time.
void FitPlainly(const WrenchRegression& r, const std::vector<int>& rows,
                const std::map<int, int>& fold_of, const Eigen::VectorXd& prior, WrenchFit* fit) {
  const int n = static_cast<int>(r.prior_sigma.size());
  std::array<std::array<Eigen::MatrixXd, kNumChannels>, kFolds> grams;
  for (int c = 0; c < r.num_channels; ++c) {
    std::array<Eigen::MatrixXd, kFolds> part;
    std::array<int, kFolds> count{};
    for (auto& p : part) p.resize(static_cast<int>(rows.size()), n + 1);
    for (const int i : rows) {
      const int f = fold_of.at(r.block[i]);
      part[f].row(count[f]) << r.columns[c].row(i), r.y(i, c);
      ++count[f];
    }
    for (int f = 0; f < kFolds; ++f) {
      grams[f][c] = part[f].topRows(count[f]).transpose() * part[f].topRows(count[f]);
    }
  }
  const double samples = static_cast<double>(rows.size());
  std::array<double, kNumChannels> variance{};
  Eigen::VectorXd step = Eigen::VectorXd::Zero(n);
  const auto square = [&](const Eigen::MatrixXd& gram, const Eigen::VectorXd& at) {
    return gram(n, n) - 2.0 * at.dot(gram.col(n).head(n)) + at.dot(gram.topLeftCorner(n, n) * at);
  };
  const auto solve = [&](int left_out) {
    Eigen::MatrixXd H = Eigen::MatrixXd::Zero(n, n);
    Eigen::VectorXd g = prior.cwiseProduct(r.prior_offset);
    for (int f = 0; f < kFolds; ++f) {
      if (f == left_out) continue;
      for (int c = 0; c < r.num_channels; ++c) {
        H += grams[f][c].topLeftCorner(n, n) / variance[c];
        g += grams[f][c].col(n).head(n) / variance[c];
      }
    }
    H.diagonal() += prior;
    return Eigen::VectorXd(H.ldlt().solve(g));
  };
  for (int round = 0; round < kRounds; ++round) {
    for (int c = 0; c < r.num_channels; ++c) {
      double sum = 0.0;
      for (int f = 0; f < kFolds; ++f) sum += square(grams[f][c], step);
      variance[c] = std::max(sum / samples, 1e-300);
    }
    step = solve(-1);
  }
  fit->plain_fold_squares.assign(kFolds, {});
  for (int f = 0; f < kFolds; ++f) {
    const Eigen::VectorXd without = solve(f);
    for (int c = 0; c < r.num_channels; ++c) {
      const double sum = std::max(0.0, square(grams[f][c], without));
      fit->plain_fold_squares[f][c] = sum;
      fit->plain_mean_square[c] += sum / samples;
    }
  }
  fit->plain_step = step;
  fit->plain_variance = variance;
  fit->plain_residual = r.y;
  for (int c = 0; c < r.num_channels; ++c) {
    fit->plain_residual.col(c) = r.y.col(c) - r.columns[c] * step;
  }
}

}  // namespace

WrenchFit FitWrench(const WrenchRegression& r) {
  const int n = static_cast<int>(r.prior_sigma.size());
  const std::vector<int> rows = RowsInUse(r);
  WrenchFit fit;
  // Blocks in use, in the order of time; block b belongs to fold b mod kFolds.
  std::map<int, int> fold_of;
  for (const int i : rows) fold_of.emplace(r.block[i], 0);
  int count = 0;
  for (auto& entry : fold_of) entry.second = count++ % kFolds;

  const Eigen::VectorXd prior = r.prior_sigma.cwiseAbs2().cwiseInverse();
  FitPlainly(r, rows, fold_of, prior, &fit);
  // From here, and not from y: strongly correlated noise would take in what columns explain that
  // are not exact in time.
  fit.residual = fit.plain_residual;
  fit.step = fit.plain_step;
  std::array<Channel, kNumChannels> white;
  std::array<Noise, kNumChannels> noise;
  std::array<Eigen::MatrixXd, kFolds> grams;
  Eigen::MatrixXd total;
  for (int round = 0; round < kRounds; ++round) {
    for (Eigen::MatrixXd& gram : grams) gram.setZero(n + 1, n + 1);
    for (int c = 0; c < r.num_channels; ++c) {
      noise[c] = FitNoise(fit.residual.col(c), rows);
      white[c] = Whiten(r, c, noise[c], rows);
      // Wild samples pull no harder than kWildSigmas.
      for (size_t k = 0; k < rows.size(); ++k) {
        const double e = white[c](k, n) - white[c].row(k).head(n).dot(fit.step);
        if (std::abs(e) > kWildSigmas) white[c].row(k) *= std::sqrt(kWildSigmas / std::abs(e));
      }
      for (int f = 0; f < kFolds; ++f) {
        Channel part(white[c].rows(), n + 1);
        int m = 0;
        for (size_t k = 0; k < rows.size(); ++k) {
          if (fold_of[r.block[rows[k]]] == f) part.row(m++) = white[c].row(k);
        }
        grams[f].noalias() += part.topRows(m).transpose() * part.topRows(m);
      }
    }
    total.setZero(n + 1, n + 1);
    for (const Eigen::MatrixXd& gram : grams) total += gram;
    Eigen::MatrixXd H = total.topLeftCorner(n, n);
    H.diagonal() += prior;
    const Eigen::LDLT<Eigen::MatrixXd> ldlt(H);
    fit.step = ldlt.solve(total.col(n).head(n) + prior.cwiseProduct(r.prior_offset));
    fit.covariance = ldlt.solve(Eigen::MatrixXd::Identity(n, n));
    for (int c = 0; c < r.num_channels; ++c) {
      fit.residual.col(c) = r.y.col(c) - r.columns[c] * fit.step;
    }
  }

  // Each fold predicted by the others.
  fit.rows = rows;
  for (const int i : rows) fit.fold.push_back(fold_of[r.block[i]]);
  fit.leverage = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(rows.size()), r.num_channels);
  for (int f = 0; f < kFolds; ++f) {
    Eigen::MatrixXd H = (total - grams[f]).topLeftCorner(n, n);
    H.diagonal() += prior;
    const Eigen::LDLT<Eigen::MatrixXd> ldlt(H);
    const Eigen::VectorXd step =
        ldlt.solve((total - grams[f]).col(n).head(n) + prior.cwiseProduct(r.prior_offset));
    const Eigen::MatrixXd covariance = ldlt.solve(Eigen::MatrixXd::Identity(n, n));
    fit.unseen_residual.emplace_back(r.y);
    for (int c = 0; c < r.num_channels; ++c) {
      fit.unseen_residual[f].col(c) -= r.columns[c] * step;
      for (size_t k = 0; k < rows.size(); ++k) {
        if (fit.fold[k] != f) continue;
        const Eigen::VectorXd x = white[c].row(k).head(n);
        fit.leverage(k, c) = x.dot(covariance * x);
      }
    }
  }
  for (int c = 0; c < kNumChannels; ++c) fit.noise_coefficients[c] = noise[c].coefficients;
  for (int c = 0; c < r.num_channels; ++c) fit.innovation_variance[c] = noise[c].variance;
  return fit;
}

Gain CrossValidatedGain(const WrenchFit& base, const WrenchFit& fit) {
  Gain gain;
  Eigen::VectorXd of_sample = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(fit.rows.size()));
  for (Eigen::Index c = 0; c < fit.leverage.cols(); ++c) {
    const auto innovation = [&](const WrenchFit& of, size_t k) {
      const auto& e = of.unseen_residual[of.fold[k]];
      double white = e(of.rows[k], c);
      for (int lag = 0; lag < kOrder; ++lag) {
        white -= fit.noise_coefficients[c][lag] * e(of.rows[k] - 1 - lag, c);
      }
      return white;
    };
    double was = 0.0, is = 0.0, count = 0.0;
    Eigen::VectorXd change = Eigen::VectorXd::Zero(of_sample.size());  // of squares
    for (size_t k = 0; k < fit.rows.size(); ++k) {
      if (base.leverage(k, c) > kLargestLeverage || fit.leverage(k, c) > kLargestLeverage) continue;
      const double before = std::pow(innovation(base, k), 2);
      const double after = std::pow(innovation(fit, k), 2);
      change[static_cast<Eigen::Index>(k)] = before - after;
      was += before;
      is += after;
      count += 1.0;
    }
    if (!(is > 0.0 && was > 0.0)) continue;
    gain.nats += 0.5 * count * std::log(was / is);
    of_sample += 0.5 * count / is * change;
  }
  gain.sigma = (of_sample.array() - of_sample.mean()).matrix().norm();
  return gain;
}

bool IsWorseThroughout(const WrenchFit& base, const WrenchFit& fit, int channel) {
  constexpr double kSigmas = 2.0;
  std::vector<double> changes;
  double sum = 0.0;
  for (size_t f = 0; f < base.plain_fold_squares.size(); ++f) {
    const double was = base.plain_fold_squares[f][channel], is = fit.plain_fold_squares[f][channel];
    if (was == 0.0 && is == 0.0) continue;  // an empty fold
    changes.push_back(is - was);
    sum += is - was;
  }
  const double n = static_cast<double>(changes.size());
  if (n < 2.0) return sum > 0.0;
  double square = 0.0;
  for (const double change : changes) square += (change - sum / n) * (change - sum / n);
  return sum > kSigmas * std::sqrt(square * n / (n - 1.0));
}

QuickGain::QuickGain(const WrenchRegression& base, const WrenchFit& fit, bool serial)
    : num_channels_(base.num_channels),
      rows_(RowsInUse(base)),
      coefficients_(fit.noise_coefficients) {
  for (int c = 0; c < num_channels_; ++c) {
    double variance = fit.innovation_variance[c];
    if (!serial) {
      coefficients_[c].setZero();
      variance = fit.plain_residual.col(c).squaredNorm() /
                 static_cast<double>(std::max<Eigen::Index>(1, fit.plain_residual.rows()));
    }
    sigma_[c] = std::sqrt(std::max(variance, 1e-300));
  }
  const int n = static_cast<int>(base.prior_sigma.size());
  WrenchColumns y;
  for (int c = 0; c < kNumChannels; ++c) {
    y[c] = serial ? fit.residual.col(c) : fit.plain_residual.col(c);
  }
  rest_ = Whitened(y);
  Q_ = Eigen::MatrixXd::Zero(rest_.size(), n);
  if (n == 0) return;
  Eigen::MatrixXd A = Whitened(base.columns);
  for (int k = 0; k < n; ++k) A.col(k) /= std::max(A.col(k).norm(), 1e-300);
  const Eigen::HouseholderQR<Eigen::MatrixXd> qr(A);
  Q_ = qr.householderQ() * Eigen::MatrixXd::Identity(A.rows(), n);
  rest_ -= Q_ * (Q_.transpose() * rest_);
}

Eigen::MatrixXd QuickGain::Whitened(const WrenchColumns& columns) const {
  const auto count = static_cast<Eigen::Index>(rows_.size());
  Eigen::MatrixXd white(count * num_channels_, columns[0].cols());
  for (int c = 0; c < num_channels_; ++c) {
    for (Eigen::Index k = 0; k < count; ++k) {
      const int i = rows_[k];
      auto row = white.row(c * count + k);
      row = columns[c].row(i);
      for (int lag = 0; lag < kOrder; ++lag) {
        row -= coefficients_[c][lag] * columns[c].row(i - 1 - lag);
      }
      row /= sigma_[c];
    }
  }
  return white;
}

double QuickGain::Of(const WrenchColumns& columns) const {
  Eigen::MatrixXd X = Whitened(columns);
  X -= Q_ * (Q_.transpose() * X).eval();
  Eigen::MatrixXd H = X.transpose() * X;
  H.diagonal().array() += 1e-9 * H.diagonal().maxCoeff() + 1e-300;
  const Eigen::VectorXd g = X.transpose() * rest_;
  return 0.5 * g.dot(H.ldlt().solve(g));
}

}  // namespace odmc
