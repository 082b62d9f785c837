#include "odmc/inspection/rotor_regression.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <complex>

#include "odmc/math/statistics.h"

namespace odmc {
namespace {

using Eigen::MatrixXcd;
using Eigen::MatrixXd;
using Eigen::VectorXcd;
using Eigen::VectorXd;
using Complex = std::complex<double>;

constexpr double kDegrees = 4.0;  // of Student's t over a block: a heavy tail
constexpr double kOverlap = 0.5;  // of neighbouring blocks: each counts half
constexpr int kFewestBlocks = 5;  // fewer scatter too little to say how sure they are
constexpr int kIterations = 8;    // of weights and noise: by two the likelihood is far off
constexpr double kLagPrior_s = 0.05;
// What is searched: 150 ms either way, beyond 100 ms of late stamps.
constexpr double kCoarse_s = 0.015, kFine_s = 0.0025;
constexpr int kMostCoarse = 10, kMostFine = 4;
// Lags this far behind the likeliest, by free coefficients, are left out: an order has a share by
// them only where at the likeliest all orders fit worse than free coefficients by e^30.
constexpr double kLagNats = 30.0;
constexpr int kMixed = 4;  // thrust, roll, pitch, yaw
// Power over the noise's from which a direction moves for sure: the level found for a rotor is some
// 20 % off, by a third where a little motion is in its weakest band. And what the directions used
// and not used may be turned by: as levers are compared (kCoupling of rotor_assignment.cpp).
constexpr double kStandsOut = 1.5, kMostTurned = 0.1;

/// One block of a regression: bins×p regressors and bins×1 responses.
struct Rows {
  MatrixXcd x;
  VectorXcd y;
};

/// Delays every bin by `lag_s`.
MatrixXcd Delayed(MatrixXcd x, const std::vector<double>& omega, double lag_s) {
  for (Eigen::Index k = 0; k < x.rows(); ++k) {
    x.row(k) *= std::polar(1.0, -omega[static_cast<size_t>(k)] * lag_s);
  }
  return x;
}

/// Iteratively reweighted least squares over blocks, which must outlive it.
class Regression {
 public:
  explicit Regression(const std::vector<Rows>& rows)
      : rows_(rows), bins_(rows.front().y.size()), p_(rows.front().x.cols()) {
    weight_ = VectorXd::Ones(static_cast<Eigen::Index>(rows.size()));
    noise_ = VectorXd::Zero(bins_);
    for (const Rows& block : rows) noise_ += block.y.cwiseAbs2() / static_cast<double>(rows.size());
    noise_ = noise_.array() + 1e-30;
  }

  BandRegression Run() {
    for (int i = 0; i < kIterations; ++i) {
      Solve();
      Weigh();
    }
    const double scatter = std::max(1.0, Scatter());
    return {value_, normal_ / scatter, -0.5 * Cost(), scatter};
  }

  /// What the regressors leave of block `s`.
  VectorXcd Residual(size_t s) const { return rows_[s].y - rows_[s].x * value_; }

 private:
  MatrixXcd Whitened(size_t s, MatrixXcd x) const {
    const auto root = (weight_[static_cast<Eigen::Index>(s)] / noise_.array()).sqrt();
    for (Eigen::Index k = 0; k < bins_; ++k) x.row(k) *= root[k];
    return x;
  }

  void Solve() {
    normal_ = MatrixXd::Zero(p_, p_);
    VectorXd right = VectorXd::Zero(p_);
    for (size_t s = 0; s < rows_.size(); ++s) {
      const MatrixXcd x = Whitened(s, rows_[s].x), y = Whitened(s, rows_[s].y);
      normal_ += (x.adjoint() * x).real();
      right += (x.adjoint() * y).real();
    }
    // Two real numbers a bin double the information, the overlap halves it.
    normal_ *= 2.0 * kOverlap;
    right *= 2.0 * kOverlap;
    const MatrixXd ridge = 1e-12 * normal_.trace() * MatrixXd::Identity(p_, p_);
    normal_ += ridge;
    value_ = normal_.ldlt().solve(right);
  }

  /// New spectrum of the noise, smoothed over neighbouring bins, and weights of the blocks.
  void Weigh() {
    const double all = static_cast<double>(rows_.size()) * static_cast<double>(bins_);
    VectorXd power = VectorXd::Zero(bins_);
    for (size_t s = 0; s < rows_.size(); ++s) {
      power += weight_[static_cast<Eigen::Index>(s)] * Residual(s).cwiseAbs2();
    }
    power *= all / std::max(all - static_cast<double>(p_), 1.0) / weight_.sum();
    const VectorXd level = (power.array() + 1e-30).log();
    for (Eigen::Index k = 0; k < bins_; ++k) {
      const Eigen::Index a = std::max<Eigen::Index>(k - 1, 0), b = std::min(k + 1, bins_ - 1);
      noise_[k] = std::exp((level[a] + level[k] + level[b]) / 3.0);
    }
    for (size_t s = 0; s < rows_.size(); ++s) {
      weight_[static_cast<Eigen::Index>(s)] = (kDegrees + Degrees()) / (kDegrees + Chi(s));
    }
  }

  double Degrees() const { return 2.0 * kOverlap * static_cast<double>(bins_); }
  double Chi(size_t s) const {
    return 2.0 * kOverlap * (Residual(s).cwiseAbs2().array() / noise_.array()).sum();
  }

  /// Twice the negative log likelihood of Student's t, up to what all regressions share.
  double Cost() const {
    double cost = 2.0 * kOverlap * static_cast<double>(rows_.size()) * noise_.array().log().sum();
    for (size_t s = 0; s < rows_.size(); ++s) {
      cost += (kDegrees + Degrees()) * std::log1p(Chi(s) / kDegrees);
    }
    return cost;
  }

  /// Mean ratio of the variance that the scatter of the blocks shows to the nominal one.
  double Scatter() const {
    const auto n = static_cast<Eigen::Index>(rows_.size());
    MatrixXd pull(p_, n);
    for (size_t s = 0; s < rows_.size(); ++s) {
      const MatrixXcd x = Whitened(s, rows_[s].x), r = Whitened(s, Residual(s));
      pull.col(static_cast<Eigen::Index>(s)) = (x.adjoint() * r).real();
    }
    const MatrixXd beside = pull.rightCols(n - 1) * pull.leftCols(n - 1).transpose();
    MatrixXd shown = pull * pull.transpose() + kOverlap * (beside + beside.transpose());
    shown *= static_cast<double>(n) / std::max(1.0, static_cast<double>(n - p_));
    return normal_.ldlt().solve(shown).trace() / static_cast<double>(p_);
  }

  const std::vector<Rows>& rows_;
  Eigen::Index bins_, p_;
  VectorXd weight_, noise_, value_;
  MatrixXd normal_;
};

/// What the readings say about the true speeds, bin by bin: errors of the regressors would lower
/// the coefficients, those of directions that move little more than those of others, and what is
/// left of them would be the controller's answer to the motion. The best linear estimate of the
/// true spectra takes the noise's share out of the regressors; the residual then has the rest of
/// it.
class Cleaner {
 public:
  explicit Cleaner(const RotorBlocks& blocks) : blocks_(blocks) {
    const Eigen::Index bins = blocks.noise.rows(), n = blocks.noise.cols();
    std::vector<MatrixXd> power;
    MatrixXd all = MatrixXd::Zero(n, n);
    for (Eigen::Index k = 0; k < bins; ++k) {
      size_.push_back(NoiseSize(k));
      power.push_back(Power(k));
      all += power.back();
    }
    const Eigen::SelfAdjointEigenSolver<MatrixXd> found(all / static_cast<double>(bins));
    const MatrixXd& directions = found.eigenvectors();
    std::vector<MatrixXd> near;
    VectorXd most = VectorXd::Zero(n);
    for (Eigen::Index k = 0; k < bins; ++k) {
      const Eigen::Index first = std::max<Eigen::Index>(k - 1, 0), last = std::min(k + 1, bins - 1);
      MatrixXd sum = MatrixXd::Zero(n, n);
      for (Eigen::Index i = first; i <= last; ++i) sum += power[static_cast<size_t>(i)];
      near.emplace_back(directions.transpose() * sum * directions /
                        static_cast<double>(last - first + 1));
      most = most.cwiseMax(near.back().diagonal());
    }
    const Eigen::Index unmixed = Unmixed(found.eigenvalues());
    // A direction that moves in no bin is left out. By a bin's covariance, which is noisy, it would
    // move a little with what moves most, and the smallest torque that goes with that would be a
    // large coefficient.
    Eigen::Index still = unmixed;
    while (unmixed == 0 && still < n && most[still] < kStandsOut) ++still;
    for (const MatrixXd& seen : near) {
      MatrixXd keep = MatrixXd::Zero(n, n);
      keep.topLeftCorner(unmixed, unmixed).setIdentity();
      const Eigen::Index moved = n - still;
      keep.bottomRightCorner(moved, moved) = Shares(seen.bottomRightCorner(moved, moved));
      keep_.emplace_back(directions * keep * directions.transpose());
    }
  }

  /// @param squared of a block, bins×n
  MatrixXcd Clean(MatrixXcd squared) const {
    for (Eigen::Index k = 0; k < squared.rows(); ++k) {
      const VectorXd& size = size_[static_cast<size_t>(k)];
      const MatrixXcd row = squared.row(k) * size.cwiseInverse().asDiagonal();
      squared.row(k) = row * keep_[static_cast<size_t>(k)] * size.asDiagonal();
    }
    return squared;
  }

 private:
  VectorXd NoiseSize(Eigen::Index k) const {
    double power = 0.0;
    for (const RotorBlock& block : blocks_.blocks) power += block.squared.row(k).squaredNorm();
    const double least = 1e-12 * power / static_cast<double>(blocks_.blocks.size());
    return (blocks_.noise.row(k).transpose().array() + least + 1e-30).sqrt();
  }

  /// Power of the readings of one bin, in units of the noise, n×n.
  MatrixXd Power(Eigen::Index k) const {
    const VectorXd inverse = NoiseSize(k).cwiseInverse();
    MatrixXd power = MatrixXd::Zero(inverse.size(), inverse.size());
    for (const RotorBlock& block : blocks_.blocks) {
      power += (block.squared.row(k).adjoint() * block.squared.row(k)).real();
    }
    return inverse.asDiagonal() * power * inverse.asDiagonal() /
           static_cast<double>(blocks_.blocks.size());
  }

  /// Independent real numbers of each column in so many bins.
  double Samples(double bins) const {
    return 2.0 * kOverlap * bins * static_cast<double>(blocks_.blocks.size());
  }

  /// How many of the directions that move least a mixer does not use. It moves each rotor by its
  /// lever, in four directions, so that levers have no part along the others: noise that stays
  /// there shows it. None, where those four do not stand out.
  Eigen::Index Unmixed(const VectorXd& rising) const {
    const Eigen::Index unmixed = rising.size() - kMixed;
    if (unmixed <= 0) return 0;
    const double used = rising[unmixed], other = rising[unmixed - 1];
    // Variance of the angle between the two.
    const double turned =
        used * other /
        (Samples(static_cast<double>(blocks_.noise.rows())) * std::pow(used - other, 2));
    return used > kStandsOut * other && turned < kMostTurned * kMostTurned ? unmixed : 0;
  }

  /// The share of the true speeds in readings of that power (in units of the noise, of three bins).
  MatrixXd Shares(const MatrixXd& power) const {
    if (power.size() == 0) return power;
    const Eigen::SelfAdjointEigenSolver<MatrixXd> found(power);
    // The largest that noise alone shows (Marchenko and Pastur).
    const double edge =
        std::pow(1.0 + std::sqrt(static_cast<double>(power.rows()) / Samples(3.0)), 2);
    VectorXd share = found.eigenvalues();
    for (double& of : share) of = of > edge ? 1.0 - 1.0 / of : 0.0;
    return found.eigenvectors() * share.asDiagonal() * found.eigenvectors().transpose();
  }

  const RotorBlocks& blocks_;
  std::vector<MatrixXd> keep_;  // n×n, in units of the noise
  std::vector<VectorXd> size_;  // of the noise, n×1
};

/// Scales a flight's spectra to those of the nominal vehicle.
class Scaled {
 public:
  Scaled(const RotorBlocks& blocks, const Vehicle& vehicle, double hover_squared)
      : blocks_(blocks), hover_squared_(hover_squared) {
    const Cleaner cleaner(blocks);
    for (const RotorBlock& block : blocks.blocks) {
      squared_.push_back(cleaner.Clean(block.squared));
    }
    const double hover_N = vehicle.mass_kg * vehicle.gravity_m_s2 / vehicle.num_rotors();
    lever_ = vehicle.inertia_kg_m2 / hover_N;
  }

  std::vector<Rows> On(int axis, double lag_s, bool with_spin_up) const {
    std::vector<Rows> rows;
    for (size_t s = 0; s < squared_.size(); ++s) {
      const Eigen::Index n = squared_[s].cols();
      MatrixXcd x(squared_[s].rows(), with_spin_up ? 2 * n : n);
      x.leftCols(n) = squared_[s] / hover_squared_;
      // As read: these only take what is theirs from the squares, and noise keeps small what cannot
      // be seen. Cleaned, they were large where thrust alone moves, and the spins wrong.
      if (with_spin_up)
        x.rightCols(n) = 2.0 / std::sqrt(hover_squared_) * blocks_.blocks[s].spin_up;
      rows.push_back({Delayed(std::move(x), blocks_.omega, lag_s),
                      VectorXcd(lever_[axis] * blocks_.blocks[s].turn.col(axis))});
    }
    return rows;
  }

 private:
  const RotorBlocks& blocks_;
  std::vector<MatrixXcd> squared_;  // cleaned, per block
  double hover_squared_;
  Eigen::Vector3d lever_;
};

/// Adds what a regression of another axis leaves, of any phase, to the regressors: gusts and loads
/// push several axes at once, the controller answers on the quick ones, and that answer would look
/// like the cause of the turning of the slow one.
void AddResidual(const Regression& other, std::vector<Rows>* rows) {
  for (size_t s = 0; s < rows->size(); ++s) {
    MatrixXcd& x = (*rows)[s].x;
    const VectorXcd left = other.Residual(s);
    x.conservativeResize(Eigen::NoChange, x.cols() + 2);
    x.col(x.cols() - 2) = left;
    x.col(x.cols() - 1) = Complex(0.0, 1.0) * left;
  }
}

/// The first `p` coefficients, whatever the others are.
BandRegression Marginal(const BandRegression& all, Eigen::Index p) {
  const Eigen::Index rest = all.value.size() - p;
  const MatrixXd beside = all.information.topRightCorner(p, rest);
  const MatrixXd own = all.information.bottomRightCorner(rest, rest);
  BandRegression result;
  result.log_likelihood = all.log_likelihood;
  result.scatter = all.scatter;
  result.value = all.value.head(p);
  result.information =
      all.information.topLeftCorner(p, p) - beside * own.ldlt().solve(MatrixXd(beside.transpose()));
  return result;
}

RotorLag ResponseAt(const Scaled& scaled, double lag_s) {
  RotorLag result;
  result.lag_s = lag_s;
  result.roll = Regression(scaled.On(0, lag_s, false)).Run();
  result.pitch = Regression(scaled.On(1, lag_s, false)).Run();
  return result;
}

double LagPrior(double lag_s) { return -0.5 * std::pow(lag_s / kLagPrior_s, 2); }

/// The lags that the motion about roll and pitch leaves possible, the likeliest first.
std::vector<RotorLag> PossibleLags(const Scaled& scaled) {
  std::vector<RotorLag> tried;
  for (int i = -kMostCoarse; i <= kMostCoarse; ++i) {
    tried.push_back(ResponseAt(scaled, i * kCoarse_s));
  }
  const auto likelier = [](const RotorLag& a, const RotorLag& b) {
    const auto log = [](const RotorLag& lag) {
      return lag.roll.log_likelihood + lag.pitch.log_likelihood + LagPrior(lag.lag_s);
    };
    return log(a) > log(b);
  };
  RotorLag best = *std::min_element(tried.begin(), tried.end(), likelier);
  const double centre_s = best.lag_s;
  for (int i = -kMostFine; i <= kMostFine; ++i) {
    RotorLag fine = ResponseAt(scaled, centre_s + i * kFine_s);
    if (likelier(fine, best)) best = std::move(fine);
  }
  std::vector<RotorLag> possible = {best};
  for (RotorLag& lag : tried) {
    lag.log_likelihood = LagPrior(lag.lag_s) - LagPrior(best.lag_s) + lag.roll.LogRatio(best.roll) +
                         lag.pitch.LogRatio(best.pitch);
    // Closer ones are what the best one stands for.
    const bool is_beside = std::abs(lag.lag_s - best.lag_s) < 0.75 * kCoarse_s;
    if (!is_beside && lag.log_likelihood > -kLagNats) possible.push_back(std::move(lag));
  }
  return possible;
}

/// Yaw beside what roll and pitch leave.
BandRegression YawAt(const Scaled& scaled, double lag_s) {
  std::vector<Rows> rows = scaled.On(2, lag_s, true);
  const Eigen::Index p = rows.front().x.cols();
  for (const int axis : {0, 1}) {
    const std::vector<Rows> other_rows = scaled.On(axis, lag_s, false);
    Regression other(other_rows);
    other.Run();
    AddResidual(other, &rows);
  }
  return Marginal(Regression(rows).Run(), p);
}

/// Mean share of each column, and how sure it is.
void Share(const RotorBlocks& blocks, RotorResponse* response) {
  const auto count = static_cast<Eigen::Index>(blocks.blocks.size());
  MatrixXd shares(blocks.blocks.front().mean_squared.size(), count);
  for (Eigen::Index s = 0; s < count; ++s) {
    const VectorXd& mean = blocks.blocks[static_cast<size_t>(s)].mean_squared;
    shares.col(s) = mean / mean.sum();
  }
  response->share.resize(shares.rows());
  for (Eigen::Index j = 0; j < shares.rows(); ++j) {
    const VectorXd row = shares.row(j);
    response->share[j] = Median(std::vector<double>(row.data(), row.data() + row.size()));
  }
  response->share /= response->share.sum();
  const MatrixXd off = shares.colwise() - response->share;
  // Neighbours overlap: half as many blocks are independent. A median scatters pi/2 as much.
  const double independent = std::max(1.0, kOverlap * static_cast<double>(count));
  response->share_spread =
      0.5 * M_PI * off * off.transpose() / static_cast<double>(count) / independent;
}

}  // namespace

RotorResponse MeasureRotorResponse(const RotorBlocks& blocks, const Vehicle& vehicle) {
  RotorResponse response;
  if (static_cast<int>(blocks.blocks.size()) < std::max(kFewestBlocks, vehicle.num_rotors() + 1)) {
    return response;
  }
  response.blocks = static_cast<int>(blocks.blocks.size());
  std::vector<double> typical;
  for (const RotorBlock& block : blocks.blocks) typical.push_back(block.mean_squared.mean());
  response.hover_squared = Median(typical);
  const Scaled scaled(blocks, vehicle, response.hover_squared);
  response.lags = PossibleLags(scaled);
  for (RotorLag& lag : response.lags) lag.yaw = YawAt(scaled, lag.lag_s);
  Share(blocks, &response);
  return response;
}

}  // namespace odmc
