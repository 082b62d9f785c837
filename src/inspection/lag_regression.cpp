#include "odmc/inspection/lag_regression.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "odmc/math/statistics.h"

namespace odmc {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr double kLongestBlock_s = 1.0, kShortestBlock_s = 0.25;  // longer than that memory
constexpr int kWantedBlocks = 16, kLeastBlocks = 6;
constexpr int kLeastRows = 8;          // of a block
constexpr double kQuietest = 0.3;      // of the median block's size: the least that counts
constexpr double kElsewhere_s = 0.02;  // what lies closer belongs to the same peak
constexpr int kRounds = 4;             // of colour and sizes of the noise
constexpr double kHighPass_s = 0.3;    // 3 Hz
constexpr double kLeastShare = 0.333;
// A disturbance's torque is answered through the motors, tens of milliseconds later and in part. In
// proportion to what disturbances have of the signal, the answer is taken for the cause, and moves
// the lag by up to this time where both are alike. (Own offsets on flights whose stamps are right:
// 15 flights of shared data and simulators with shares of 0.01 to 1 stay within 3 sigma of it.)
constexpr double kAnswer_s = 0.005;
constexpr double kMostNoise = 0.1, kLeastLeft = 0.1;  // shares
constexpr double kFinest_s = 0.0004;                  // parabolas are refined down to
constexpr double kSlopeStep = 0.25;  // of the grid: slopes of the likelihood are taken over

/// What one lag explains.
struct Fit {
  MatrixXd gain;      // (k + f)×c
  MatrixXd residual;  // rows in use × c, whitened
  VectorXd nats;      // of each block
  double sum() const { return nats.sum(); }
};

/// A signal made of every other sample, from sample `first` on.
SampledSignal EveryOther(const SampledSignal& signal, int first) {
  std::vector<double> times_s;
  MatrixXd values(signal.channels(), (signal.size() - first + 1) / 2);
  for (int i = first; i < signal.size(); i += 2) {
    values.col(static_cast<Eigen::Index>(times_s.size())) = signal.values().col(i);
    times_s.push_back(signal.times_s()[i]);
  }
  return SampledSignal(std::move(times_s), std::move(values));
}

class Regression {
 public:
  explicit Regression(const LagProblem& problem);

  std::optional<StreamLag> Solve();

 private:
  int channels() const { return static_cast<int>(p_.y.cols()); }
  int moving() const { return p_.moving->channels(); }
  int fixed() const { return static_cast<int>(p_.fixed.cols()); }
  double LagOf(int j) const { return (j - reach_) * p_.step_s; }
  MatrixXd Means(const SampledSignal& signal, double lag_s, int before, int after) const;
  MatrixXd Whitened(const MatrixXd& x) const;
  MatrixXd InUse(const MatrixXd& x, int shift) const;
  void ChooseRows();
  void Colour(const MatrixXd& noise);
  void Weigh(const MatrixXd& whitened);
  Fit At(const MatrixXd& moving_in_use) const;
  Fit AtLag(double lag_s) const { return At(InUse(Whitened(Means(*p_.moving, lag_s, 0, 0)), 0)); }
  MatrixXd GainOf(const MatrixXd& moving_in_use) const;
  VectorXd Nats(const MatrixXd& residual, const MatrixXd& moving_gain) const;
  void Scan();
  double Refine(double lag_s) const;
  double PeakOf(const VectorXd& nats) const;
  double Jackknifed() const;
  void Renew(double lag_s);
  double Contrast(const Fit& best, double lag_s) const;
  Fit Without() const {
    return At(MatrixXd::Zero(static_cast<Eigen::Index>(rows_.size()), moving()));
  }
  double BandShare(double lag_s, MatrixXd* gain) const;
  double StructuredShare(const MatrixXd& residual, double all) const;
  StreamLag Judge(double lag_s) const;

  const LagProblem& p_;
  int n_, order_, reach_;
  std::vector<bool> usable_;          // y, fixed and moving at all lags
  std::vector<int> rows_, block_of_;  // whitened rows in use, and the block of each
  int blocks_ = 0;
  VectorXd filter_;             // of the noise
  VectorXd weights_;            // of rows in use
  VectorXd scale_;              // of channels
  MatrixXd halves_;             // n×k: half the difference of every other sample's signals: noise
  MatrixXd y_, fixed_, noise_;  // whitened, rows in use
  MatrixXd normal_ff_, noise_mm_;  // weighted products of these
  MatrixXd scanned_;               // blocks×lags: nats
};

Regression::Regression(const LagProblem& problem)
    : p_(problem), n_(static_cast<int>(problem.y.rows())) {
  order_ = static_cast<int>(std::lround(p_.memory_s / p_.step_s));
  reach_ = static_cast<int>(std::ceil(p_.reach_s / p_.step_s));
  usable_ = p_.usable;
  const double margin_s = (reach_ + 2) * p_.step_s;
  for (int i = 0; i < n_; ++i) {
    const double t = p_.first_s + i * p_.step_s;
    usable_[i] = usable_[i] && p_.moving->Covers(t - margin_s, t + margin_s);
  }
  filter_ = VectorXd::Zero(order_);
  ChooseRows();
  if (blocks_ < kLeastBlocks) return;
  halves_ = 0.5 * (Means(EveryOther(*p_.moving, 0), 0.0, 0, 0) -
                   Means(EveryOther(*p_.moving, 1), 0.0, 0, 0));
}

// Means over p_.width_s about every time of the grid and some before and after it.
MatrixXd Regression::Means(const SampledSignal& signal, double lag_s, int before, int after) const {
  MatrixXd x = MatrixXd::Zero(n_ + before + after, signal.channels());
  for (int i = -before; i < n_ + after; ++i) {
    const double t = p_.first_s + i * p_.step_s + lag_s;
    const double from = t - 0.5 * p_.width_s, to = t + 0.5 * p_.width_s;
    if (from < signal.first_s() || to > signal.last_s()) continue;
    x.row(i + before) = signal.Mean(from, to).transpose();
  }
  return x;
}

// x_i - sum a_k x_{i-k}, for the whole of x; rows at its beginning are not used.
MatrixXd Regression::Whitened(const MatrixXd& x) const {
  MatrixXd white = x;
  const Eigen::Index n = x.rows();
  for (int k = 1; k <= order_ && k < n; ++k) {
    white.bottomRows(n - k).noalias() -= filter_[k - 1] * x.topRows(n - k);
  }
  return white;
}

MatrixXd Regression::InUse(const MatrixXd& x, int shift) const {
  MatrixXd rows(static_cast<Eigen::Index>(rows_.size()), x.cols());
  for (Eigen::Index c = 0; c < x.cols(); ++c) {
    for (size_t r = 0; r < rows_.size(); ++r) {
      rows(static_cast<Eigen::Index>(r), c) = x(rows_[r] + shift, c);
    }
  }
  return rows;
}

// Rows whose whole past is usable, and the blocks of time they fall into.
void Regression::ChooseRows() {
  std::vector<int> rows;
  int run = 0;
  for (int i = 0; i < n_; ++i) {
    run = usable_[i] ? run + 1 : 0;
    if (run > order_) rows.push_back(i);
  }
  const double seconds = static_cast<double>(rows.size()) * p_.step_s;
  const double block_s = std::clamp(seconds / kWantedBlocks, kShortestBlock_s, kLongestBlock_s);
  const int length = std::max(kLeastRows, static_cast<int>(std::lround(block_s / p_.step_s)));
  // Blocks are counted in rows in use; what is left at the end is no block.
  blocks_ = static_cast<int>(rows.size()) / length;
  for (int i = 0; i < blocks_ * length; ++i) {
    rows_.push_back(rows[static_cast<size_t>(i)]);
    block_of_.push_back(i / length);
  }
  weights_ = VectorXd::Ones(static_cast<Eigen::Index>(rows_.size()));
  scale_ = VectorXd::Ones(channels());
}

// Autoregression of the noise (n×c, channels in units of their scale), by Levinson's recursion.
void Regression::Colour(const MatrixXd& noise) {
  const VectorXd precision = scale_.cwiseAbs2().cwiseInverse();
  VectorXd covariance = VectorXd::Zero(order_ + 1);
  for (size_t r = 0; r < rows_.size(); ++r) {
    const int i = rows_[r];
    for (int k = 0; k <= order_; ++k) {
      covariance[k] += weights_[static_cast<Eigen::Index>(r)] *
                       noise.row(i).cwiseProduct(noise.row(i - k)).dot(precision.transpose());
    }
  }
  filter_.setZero();
  double error = covariance[0] * (1.0 + 1e-9);
  for (int k = 0; k < order_ && error > 0.0; ++k) {
    double reflection = covariance[k + 1];
    for (int j = 0; j < k; ++j) reflection -= filter_[j] * covariance[k - j];
    reflection /= error;
    const VectorXd before = filter_.head(k);
    for (int j = 0; j < k; ++j) filter_[j] = before[j] - reflection * before[k - 1 - j];
    filter_[k] = reflection;
    error *= 1.0 - reflection * reflection;
  }
}

// Channels by their size, blocks by theirs.
void Regression::Weigh(const MatrixXd& whitened) {
  scale_ = ((weights_.transpose() * whitened.cwiseAbs2()).transpose() / weights_.sum())
               .cwiseSqrt()
               .cwiseMax(1e-12);
  VectorXd square = VectorXd::Zero(blocks_), count = VectorXd::Zero(blocks_);
  for (Eigen::Index r = 0; r < whitened.rows(); ++r) {
    square[block_of_[r]] += whitened.row(r).transpose().cwiseQuotient(scale_).squaredNorm();
    count[block_of_[r]] += channels();
  }
  std::vector<double> sizes;
  for (int b = 0; b < blocks_; ++b) sizes.push_back(std::sqrt(square[b] / count[b]));
  const double least = std::max(kQuietest * Median(sizes), 1e-12);
  for (Eigen::Index r = 0; r < weights_.size(); ++r) {
    const double size = std::max(sizes[static_cast<size_t>(block_of_[r])], least);
    weights_[r] = 1.0 / (size * size);
  }
}

// Log-likelihood of each block whose own noise may have any size: a stretch of other size (ground,
// a crash) counts no more than any other. What noise of the moving signal leaves is not held
// against a gain.
VectorXd Regression::Nats(const MatrixXd& residual, const MatrixXd& moving_gain) const {
  VectorXd square = VectorXd::Zero(blocks_), own = VectorXd::Zero(blocks_),
           count = VectorXd::Zero(blocks_), quiet = VectorXd::Zero(blocks_);
  const VectorXd precision = scale_.cwiseAbs2().cwiseInverse();
  const VectorXd squares = residual.cwiseAbs2() * precision;
  const VectorXd brought = (noise_ * moving_gain).cwiseAbs2() * precision;
  for (Eigen::Index r = 0; r < residual.rows(); ++r) {
    const int b = block_of_[r];
    square[b] += squares[r];
    own[b] += brought[r];
    count[b] += channels();
    quiet[b] = 1.0 / weights_[r];
  }
  VectorXd nats(blocks_);
  for (int b = 0; b < blocks_; ++b) {
    const double left = std::max(square[b] - own[b], kLeastLeft * square[b]);
    nats[b] = -0.5 * count[b] * std::log(left / count[b] + 1e-3 * quiet[b] + 1e-30);
  }
  return nats;
}

// Least squares, less what noise in the moving signal adds to its own square: errors in it would
// shrink its gain and let what goes along with its derivative (drag, damping) take its place.
MatrixXd Regression::GainOf(const MatrixXd& x) const {
  const int k = moving(), f = fixed();
  const MatrixXd weighted = weights_.asDiagonal() * x;
  const MatrixXd mf = weighted.transpose() * fixed_;
  const Eigen::LDLT<MatrixXd> ff(normal_ff_);
  const MatrixXd fy = fixed_.transpose() * weights_.asDiagonal() * y_;
  const MatrixXd schur = weighted.transpose() * x - mf * ff.solve(mf.transpose());
  const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(schur - noise_mm_);
  // Directions that are mostly noise keep some of it, so that no gain explodes.
  const double least = kMostNoise * noise_mm_.trace() / k + 1e-9 * schur.norm() + 1e-30;
  const VectorXd values = eigen.eigenvalues().cwiseMax(least);
  MatrixXd gain(k + f, channels());
  const MatrixXd my = weighted.transpose() * y_ - mf * ff.solve(fy);
  gain.topRows(k) = eigen.eigenvectors() * values.cwiseInverse().asDiagonal() *
                    eigen.eigenvectors().transpose() * my;
  gain.bottomRows(f) = ff.solve(fy - mf.transpose() * gain.topRows(k));
  return gain;
}

Fit Regression::At(const MatrixXd& x) const {
  Fit fit;
  fit.gain = GainOf(x);
  fit.residual = y_ - x * fit.gain.topRows(moving()) - fixed_ * fit.gain.bottomRows(fixed());
  fit.nats = Nats(fit.residual, fit.gain.topRows(moving()));
  return fit;
}

// All lags in steps of the grid.
void Regression::Scan() {
  const MatrixXd white = Whitened(Means(*p_.moving, 0.0, reach_ + order_, reach_));
  scanned_.resize(blocks_, 2 * reach_ + 1);
  for (int j = 0; j <= 2 * reach_; ++j) scanned_.col(j) = At(InUse(white, order_ + j)).nats;
}

// The best lag near this one: parabolas through three, closer and closer.
double Regression::Refine(double lag_s) const {
  for (double step_s = 0.5 * p_.step_s; step_s > kFinest_s; step_s *= 0.5) {
    const double before = AtLag(lag_s - step_s).sum(), here = AtLag(lag_s).sum(),
                 after = AtLag(lag_s + step_s).sum();
    const double bend = before - 2.0 * here + after;
    if (bend < 0.0) {
      lag_s -= std::clamp(0.5 * (after - before) / bend, -1.5, 1.5) * step_s;
    } else {
      lag_s += after > before ? step_s : -step_s;
    }
  }
  return lag_s;
}

// Colour and sizes of the noise as this lag leaves it.
void Regression::Renew(double lag_s) {
  MatrixXd noise = p_.y;
  if (y_.size() > 0) {
    const Fit fit = AtLag(lag_s);
    noise -= Means(*p_.moving, lag_s, 0, 0) * fit.gain.topRows(moving()) +
             p_.fixed * fit.gain.bottomRows(fixed());
  }
  Colour(noise);
  Weigh(InUse(Whitened(noise), 0));
  y_ = InUse(Whitened(p_.y), 0);
  fixed_ = InUse(Whitened(p_.fixed), 0);
  noise_ = InUse(Whitened(halves_), 0);
  normal_ff_ = fixed_.transpose() * weights_.asDiagonal() * fixed_;
  normal_ff_.diagonal() *= 1.0 + 1e-10;
  normal_ff_.diagonal().array() += 1e-30;
  noise_mm_ = noise_.transpose() * weights_.asDiagonal() * noise_;
}

/// Sum over its standard error, by blocks.
double OverItsError(const VectorXd& blocks) {
  const auto n = static_cast<double>(blocks.size());
  const double mean = blocks.mean();
  const double variance = (blocks.array() - mean).square().sum() / (n - 1.0);
  return variance > 0.0 ? mean * std::sqrt(n / variance) : 0.0;
}

double Regression::Contrast(const Fit& best, double lag_s) const {
  double contrast = OverItsError(best.nats - Without().nats);
  const VectorXd sums = scanned_.colwise().sum().transpose();
  for (int j = 0; j < sums.size(); ++j) {
    if (std::abs(LagOf(j) - lag_s) < std::max(kElsewhere_s, 2.0 * p_.step_s)) continue;
    const bool peak =
        (j == 0 || sums[j] >= sums[j - 1]) && (j + 1 == sums.size() || sums[j] >= sums[j + 1]);
    if (peak) contrast = std::min(contrast, OverItsError(best.nats - scanned_.col(j)));
  }
  return contrast;
}

/// What is left of a signal without its mean over 2 half + 1 steps, twice: high-pass without delay.
MatrixXd HighPassed(const MatrixXd& x, int half) {
  MatrixXd mean = x;
  for (int pass = 0; pass < 2; ++pass) {
    MatrixXd sum = MatrixXd::Zero(x.rows() + 1, x.cols());
    for (Eigen::Index i = 0; i < x.rows(); ++i) sum.row(i + 1) = sum.row(i) + mean.row(i);
    for (Eigen::Index i = 0; i < x.rows(); ++i) {
      const Eigen::Index from = std::max<Eigen::Index>(0, i - half);
      const Eigen::Index to = std::min<Eigen::Index>(x.rows(), i + half + 1);
      mean.row(i) = (sum.row(to) - sum.row(from)) / static_cast<double>(to - from);
    }
  }
  return x - mean;
}

/// Mean of neighbours with weights 1, 2, 1.
MatrixXd Smoothed(const MatrixXd& x) {
  MatrixXd y = x;
  const Eigen::Index n = x.rows() - 2;
  if (n > 0) {
    y.middleRows(1, n) = 0.25 * (x.topRows(n) + 2.0 * x.middleRows(1, n) + x.bottomRows(n));
  }
  return y;
}

// Of the signal between 3 and 20 Hz, the share that the moving stream explains: median of blocks.
double Regression::BandShare(double lag_s, MatrixXd* gain) const {
  const int half = std::max(1, static_cast<int>(std::lround(0.5 * kHighPass_s / p_.step_s)));
  const bool smooth = p_.step_s < 0.015;
  const auto band = [&](const MatrixXd& x) {
    return InUse(HighPassed(smooth ? Smoothed(x) : x, half), 0);
  };
  MatrixXd x(n_, moving() + fixed());
  x << Means(*p_.moving, lag_s, 0, 0), p_.fixed;
  const MatrixXd xb = band(x), y = band(p_.y), f = xb.rightCols(fixed());
  const auto fit = [&](const MatrixXd& by) {
    MatrixXd normal = by.transpose() * weights_.asDiagonal() * by;
    normal.diagonal() *= 1.0 + 1e-9;
    normal.diagonal().array() += 1e-30;
    return MatrixXd(normal.ldlt().solve(by.transpose() * weights_.asDiagonal() * y));
  };
  const MatrixXd all_gain = fit(xb);
  *gain = all_gain.topRows(moving());
  const MatrixXd with = y - xb * all_gain, without = y - f * fit(f);
  const VectorXd scale =
      (without.cwiseAbs2().colwise().mean().cwiseSqrt().transpose()).cwiseMax(1e-12);
  VectorXd explained = VectorXd::Zero(blocks_), all = VectorXd::Zero(blocks_);
  for (Eigen::Index r = 0; r < y.rows(); ++r) {
    const double part = with.row(r).transpose().cwiseQuotient(scale).squaredNorm();
    const double whole = without.row(r).transpose().cwiseQuotient(scale).squaredNorm();
    explained[block_of_[r]] += whole - part;
    all[block_of_[r]] += whole;
  }
  std::vector<double> shares;
  for (int b = 0; b < blocks_; ++b) shares.push_back(all[b] > 0.0 ? explained[b] / all[b] : 0.0);
  return Median(shares);
}

// Share of the signal that is neither explained nor white noise of what the signal is a difference
// of: such noise has half of its square, negative, one width later, what changes slowly all of it.
double Regression::StructuredShare(const MatrixXd& residual, double all) const {
  const int width = std::max(1, static_cast<int>(std::lround(p_.width_s / p_.step_s)));
  double later = 0.0, same = 0.0;
  for (size_t r = static_cast<size_t>(width); r < rows_.size(); ++r) {
    if (rows_[r] - rows_[r - static_cast<size_t>(width)] != width) continue;
    const auto i = static_cast<Eigen::Index>(r);
    later += weights_[i] * residual.row(i).dot(residual.row(i - width));
    same += weights_[i] * residual.row(i).squaredNorm();
  }
  return all > 0.0 ? std::clamp((same + 2.0 * later) / (3.0 * all), 0.0, 1.0) : 0.0;
}

// Where the likelihood of blocks (sums over them, by lag) is largest: a parabola through three.
double Regression::PeakOf(const VectorXd& nats) const {
  Eigen::Index best = 0;
  nats.maxCoeff(&best);
  const double lag_s = LagOf(static_cast<int>(best));
  if (best == 0 || best + 1 == nats.size()) return lag_s;
  const double bend = nats[best - 1] - 2.0 * nats[best] + nats[best + 1];
  if (!(bend < 0.0)) return lag_s;
  return lag_s - 0.5 * (nats[best + 1] - nats[best - 1]) / bend * p_.step_s;
}

// Standard deviation of the best lag by leaving out one block after the other (with gain, colour
// and weights of all). A single block may hold the lag against what all others show, and slopes
// about the best lag do not tell.
double Regression::Jackknifed() const {
  const VectorXd all = scanned_.colwise().sum().transpose();
  VectorXd without(blocks_);
  for (int b = 0; b < blocks_; ++b) without[b] = PeakOf(all - scanned_.row(b).transpose());
  const double n = blocks_;
  return std::sqrt((n - 1.0) / n * (without.array() - without.mean()).square().sum());
}

// What the likelihood around its best lag says.
StreamLag Regression::Judge(double lag_s) const {
  const double step_s = kSlopeStep * p_.step_s, b = blocks_;
  const Fit here = AtLag(lag_s), before = AtLag(lag_s - step_s), after = AtLag(lag_s + step_s);
  const double bend = (before.sum() - 2.0 * here.sum() + after.sum()) / (step_s * step_s);
  const VectorXd slope = (after.nats - before.nats) / (2.0 * step_s);
  // The variance of the sum of slopes; few blocks tell it badly (mean of 1/chi²: (b - 1)/(b - 3)).
  const double scatter = (slope.array() - slope.mean()).square().sum() * b / (b - 3.0);
  StreamLag lag;
  lag.lag_s = lag_s;
  lag.blocks = blocks_;
  lag.scatter_s = bend < 0.0 ? std::sqrt(scatter) / -bend : std::numeric_limits<double>::infinity();
  lag.scatter_s = std::max(lag.scatter_s, Jackknifed());
  lag.contrast = bend < 0.0 && std::abs(lag_s) < p_.reach_s ? Contrast(here, lag_s) : 0.0;
  lag.gain = here.gain.topRows(moving());
  const double all = (weights_.transpose() * Without().residual.cwiseAbs2()).sum();
  const double left = (weights_.transpose() * here.residual.cwiseAbs2()).sum();
  lag.explained = all > 0.0 ? 1.0 - left / all : 0.0;
  const Fit none = AtLag(0.0);
  lag.over_none = OverItsError(here.nats - none.nats);
  const MatrixXd& uncured = none.residual;
  const double before_all = (weights_.transpose() * uncured.cwiseAbs2()).sum();
  lag.cured = before_all > 0.0 ? 1.0 - left / before_all : 0.0;
  if (order_ == 0) {
    const double structured = StructuredShare(here.residual, all);
    lag.pull_s = p_.filter_s * std::sqrt(structured);
    // Noise is nothing that a lag could cure.
    const double before_structured = StructuredShare(uncured, all);
    if (before_structured > 0.0) lag.cured = 1.0 - structured / before_structured;
  }
  if (order_ > 0) {
    lag.band_share = BandShare(lag_s, &lag.band_gain);
    const double share = std::clamp(lag.band_share, kLeastShare, 1.0);
    lag.pull_s = kAnswer_s * (1.0 - share) / share;
  }
  return lag;
}

std::optional<StreamLag> Regression::Solve() {
  if (blocks_ < kLeastBlocks) return std::nullopt;
  Renew(0.0);  // at first all of y is noise
  Scan();
  Eigen::Index best = 0, before = -1;
  scanned_.colwise().sum().maxCoeff(&best);
  for (int round = 0; round < kRounds && best != before; ++round) {
    before = best;
    Renew(LagOf(static_cast<int>(best)));
    Scan();
    scanned_.colwise().sum().maxCoeff(&best);
  }
  // Once more with the noise as the best lag itself leaves it, not its neighbour on the grid.
  Renew(Refine(LagOf(static_cast<int>(best))));
  Scan();
  scanned_.colwise().sum().maxCoeff(&best);
  return Judge(Refine(LagOf(static_cast<int>(best))));
}

}  // namespace

double StreamLag::sigma_s() const { return std::hypot(scatter_s, pull_s); }

bool StreamLag::determined() const {
  return contrast >= kLeastContrast && std::isfinite(sigma_s());
}

std::optional<StreamLag> EstimateLag(const LagProblem& problem) {
  return Regression(problem).Solve();
}

}  // namespace odmc
