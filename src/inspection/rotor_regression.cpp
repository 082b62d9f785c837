#include "odmc/inspection/rotor_regression.h"

#include <Eigen/Cholesky>
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

constexpr double kDegrees = 4.0;     // of Student's t over a block: a heavy tail
constexpr double kOverlap = 0.5;     // of neighbouring blocks: each counts half
constexpr int kFewestBlocks = 5;     // fewer scatter too little to say how sure they are
constexpr double kMostLag_s = 0.15;  // what is searched, beyond 100 ms of late stamps
constexpr double kLagPrior_s = 0.05;
constexpr double kCoarse_s = 0.015, kFine_s = 0.0025;

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

  BandRegression Run(int iterations) {
    for (int i = 0; i < iterations; ++i) {
      Solve();
      Weigh();
    }
    BandRegression result{value_, normal_ / std::max(1.0, Scatter()), 0.0};
    result.log_noise = static_cast<double>(rows_.size()) * noise_.array().log().sum();
    return result;
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
    const double degrees = 2.0 * kOverlap * static_cast<double>(bins_);
    for (size_t s = 0; s < rows_.size(); ++s) {
      const double chi = 2.0 * kOverlap * (Residual(s).cwiseAbs2().array() / noise_.array()).sum();
      weight_[static_cast<Eigen::Index>(s)] = (kDegrees + degrees) / (kDegrees + chi);
    }
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

/// Scales a flight's spectra to those of the nominal vehicle.
class Scaled {
 public:
  Scaled(const RotorBlocks& blocks, const Vehicle& vehicle, double hover_squared)
      : blocks_(blocks), hover_squared_(hover_squared) {
    const double hover_N = vehicle.mass_kg * vehicle.gravity_m_s2 / vehicle.num_rotors();
    lever_ = vehicle.inertia_kg_m2 / hover_N;
  }

  std::vector<Rows> On(int axis, double lag_s, bool with_spin_up) const {
    std::vector<Rows> rows;
    for (const RotorBlock& block : blocks_.blocks) {
      const Eigen::Index n = block.squared.cols();
      MatrixXcd x(block.squared.rows(), with_spin_up ? 2 * n : n);
      x.leftCols(n) = block.squared / hover_squared_;
      if (with_spin_up) x.rightCols(n) = 2.0 / std::sqrt(hover_squared_) * block.spin_up;
      rows.push_back({Delayed(std::move(x), blocks_.omega, lag_s),
                      VectorXcd(lever_[axis] * block.turn.col(axis))});
    }
    return rows;
  }

  /// Twice the negative log likelihood of a lag, by roll and pitch.
  double CostOf(double lag_s) const {
    double cost = std::pow(lag_s / kLagPrior_s, 2);
    for (int axis = 0; axis < 2; ++axis) {
      const std::vector<Rows> rows = On(axis, lag_s, false);
      cost += 2.0 * kOverlap * Regression(rows).Run(2).log_noise;
    }
    return cost;
  }

 private:
  const RotorBlocks& blocks_;
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
  result.value = all.value.head(p);
  result.information =
      all.information.topLeftCorner(p, p) - beside * own.ldlt().solve(MatrixXd(beside.transpose()));
  return result;
}

double BestLag(const Scaled& scaled, double centre_s, double reach_s, double step_s) {
  double best_s = centre_s, least = scaled.CostOf(centre_s);
  for (int i = 1; i * step_s <= reach_s + 1e-9; ++i) {
    for (const double lag_s : {centre_s - i * step_s, centre_s + i * step_s}) {
      const double cost = scaled.CostOf(lag_s);
      if (cost < least) {
        least = cost;
        best_s = lag_s;
      }
    }
  }
  return best_s;
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
  const double coarse_s = BestLag(scaled, 0.0, kMostLag_s, kCoarse_s);
  response.lag_s = BestLag(scaled, coarse_s, 4.0 * kFine_s, kFine_s);
  constexpr int kIterations = 8;
  const std::vector<Rows> roll_rows = scaled.On(0, response.lag_s, false);
  const std::vector<Rows> pitch_rows = scaled.On(1, response.lag_s, false);
  Regression roll(roll_rows), pitch(pitch_rows);
  response.roll = roll.Run(kIterations);
  response.pitch = pitch.Run(kIterations);
  std::vector<Rows> yaw_rows = scaled.On(2, response.lag_s, true);
  const Eigen::Index p = yaw_rows.front().x.cols();
  AddResidual(roll, &yaw_rows);
  AddResidual(pitch, &yaw_rows);
  response.yaw = Marginal(Regression(yaw_rows).Run(kIterations), p);
  Share(blocks, &response);
  return response;
}

}  // namespace odmc
