#include "odmc/attribution/instruments.h"

#include <Eigen/SVD>
#include <algorithm>
#include <array>
#include <cmath>

#include "odmc/estimator/gates.h"

namespace odmc {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

// Samples of 40 ms: beyond twice the filter's half window, and no further than a manoeuvre.
constexpr std::array<int, 3> kLags = {3, 5, 8};
constexpr int kReach = 8;
constexpr int kSignals = 17;
constexpr double kRidge = 1e-3;  // of a signal's sum of squares
constexpr double kLeastForeseen = 0.2;  // of a column's sum of squares
constexpr double kFoldBlock_s = 1.0;  // a manoeuvre spans more than one

Eigen::Matrix<double, kSignals, 1> SignalsOf(const FilteredMotion& s, const Vehicle& vehicle) {
  const Eigen::Matrix3d R_BS = vehicle.odometry.q_BS.toRotationMatrix();
  Eigen::Matrix<double, kSignals, 1> signals;
  double turn = 0.0;
  for (int j = 0; j < vehicle.num_rotors(); ++j) {
    turn += vehicle.rotors[static_cast<size_t>(j)].spin * s.rotors.acceleration[j];
  }
  signals << R_BS * s.w_S, R_BS * (s.R_WS.transpose() * s.v_WS),
      s.R_WS.transpose() * Eigen::Vector3d::UnitZ(),
      RotorTorqueDirection(vehicle, s.rotors.speed_squared), s.rotors.speed_squared.sum(),
      R_BS * s.w_dot_S, turn;
  return signals;
}

}  // namespace

int Instruments::FoldAt(double t_s) { return static_cast<int>(t_s / kFoldBlock_s) % kFolds; }

Instruments::Instruments(const ThinnedFlight& flight, const Vehicle& file_vehicle)
    : likely_flight_(flight.Moving({})) {
  const int n = flight.size();
  sees_.assign(static_cast<size_t>(n), false);
  int run = 0;
  for (int i = 0; i < n; ++i) {
    run = flight.next(i) ? run + 1 : 0;
    if (run < kReach) continue;
    sees_[static_cast<size_t>(i)] = true;
    rows_.push_back(i);
    fold_.push_back(FoldAt(flight.sample(i).t_s));
    in_use_.push_back(!flight.held_out(i));
  }
  MatrixXd signals(n, kSignals);
  for (int i = 0; i < n; ++i) {
    signals.row(i) = SignalsOf(flight.sample(i), file_vehicle).transpose();
  }
  const auto m = static_cast<Index>(rows_.size());
  z_.resize(m, 1 + kSignals * static_cast<Index>(kLags.size()));
  for (Index k = 0; k < m; ++k) {
    z_(k, 0) = 1.0;
    for (size_t l = 0; l < kLags.size(); ++l) {
      z_.row(k).segment(1 + kSignals * static_cast<Index>(l), kSignals) =
          signals.row(rows_[static_cast<size_t>(k)] - kLags[l]);
    }
  }
  for (Index c = 1; c < z_.cols(); ++c) {
    z_.col(c).array() -= m > 0 ? z_.col(c).mean() : 0.0;
    const double size = z_.col(c).norm();
    if (size > 0.0) z_.col(c) *= std::sqrt(static_cast<double>(m)) / size;
  }
  gram_.assign(kFolds, MatrixXd::Zero(z_.cols(), z_.cols()));
  for (Index k = 0; k < m; ++k) {
    if (in_use_[static_cast<size_t>(k)]) {
      gram_[fold_[static_cast<size_t>(k)]].selfadjointView<Eigen::Lower>().rankUpdate(
          z_.row(k).transpose());
    }
  }
  MatrixXd all = MatrixXd::Zero(z_.cols(), z_.cols());
  for (MatrixXd& gram : gram_) {
    gram.triangularView<Eigen::StrictlyUpper>() = gram.transpose();
    all += gram;
  }
  for (const MatrixXd& gram : gram_) {
    MatrixXd others = all - gram;
    others.diagonal().array() += kRidge * static_cast<double>(m) + 1e-300;
    without_.emplace_back(others);
  }
  likely_flight_ = flight.Moving(LikelyMotion(flight));
}

std::vector<FilteredMotion> Instruments::LikelyMotion(const ThinnedFlight& flight) const {
  std::vector<FilteredMotion> samples;
  for (int i = 0; i < flight.size(); ++i) samples.push_back(flight.sample(i));
  if (samples.empty()) return samples;
  const VectorXd nothing = VectorXd::Zero(flight.size());
  const auto foresee = [&](auto value) {
    VectorXd x(flight.size());
    for (Index i = 0; i < x.size(); ++i) x[i] = value(samples[static_cast<size_t>(i)]);
    const VectorXd likely = ForeseenColumn(x, nothing);
    for (Index i = 0; i < x.size(); ++i) value(samples[static_cast<size_t>(i)]) = likely[i];
  };
  for (Index k = 0; k < 3; ++k) {
    for (Index l = 0; l < 3; ++l) {
      foresee([k, l](FilteredMotion& s) -> double& { return s.R_WS(k, l); });
    }
    foresee([k](FilteredMotion& s) -> double& { return s.p_WS[k]; });
    foresee([k](FilteredMotion& s) -> double& { return s.v_WS[k]; });
    foresee([k](FilteredMotion& s) -> double& { return s.a_WS[k]; });
    foresee([k](FilteredMotion& s) -> double& { return s.w_S[k]; });
    foresee([k](FilteredMotion& s) -> double& { return s.w_dot_S[k]; });
  }
  for (Index j = 0; j < samples.front().rotors.speed.size(); ++j) {
    foresee([j](FilteredMotion& s) -> double& { return s.rotors.speed[j]; });
    foresee([j](FilteredMotion& s) -> double& { return s.rotors.speed_squared[j]; });
    foresee([j](FilteredMotion& s) -> double& { return s.rotors.acceleration[j]; });
    foresee([j](FilteredMotion& s) -> double& { return s.rotors.speed_squared_rate[j]; });
  }
  for (int i = 0; i < flight.size(); ++i) {
    FilteredMotion& s = samples[static_cast<size_t>(i)];
    if (!Sees(i)) {
      s = flight.sample(i);
      continue;
    }
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(s.R_WS, Eigen::ComputeFullU | Eigen::ComputeFullV);
    Eigen::Matrix3d R = svd.matrixU() * svd.matrixV().transpose();
    if (R.determinant() < 0.0) R = flight.sample(i).R_WS;
    s.R_WS = R;
  }
  return samples;
}

ResidualModel::Wrenches Instruments::Foreseen(const ResidualModel::Wrenches& column,
                                              const ResidualModel::Wrenches& likely) const {
  ResidualModel::Wrenches foreseen = ResidualModel::Wrenches::Zero(column.rows(), kNumChannels);
  for (int c = 0; c < kNumChannels; ++c) {
    if (!column.col(c).isZero(0.0)) foreseen.col(c) = ForeseenColumn(column.col(c), likely.col(c));
  }
  return foreseen;
}

MatrixXd Instruments::Foreseen(const MatrixXd& columns, const MatrixXd& likely) const {
  MatrixXd foreseen(columns.rows(), columns.cols());
  for (Index c = 0; c < columns.cols(); ++c) {
    foreseen.col(c) = ForeseenColumn(columns.col(c), likely.col(c));
  }
  return foreseen;
}

VectorXd Instruments::ForeseenColumn(const VectorXd& x, const VectorXd& likely) const {
  constexpr Index kLagged = static_cast<Index>(kLags.size());
  constexpr Index kOwn = kLagged + 1;
  using Own = Eigen::Matrix<double, Eigen::Dynamic, kOwn + 1>;
  const auto m = static_cast<Index>(rows_.size());
  VectorXd foreseen = VectorXd::Zero(x.size());
  if (m == 0) return foreseen;
  // Its own past, what it would be in the likely motion, then itself.
  Own own(m, kOwn + 1);
  for (Index k = 0; k < m; ++k) {
    const int i = rows_[static_cast<size_t>(k)];
    for (Index l = 0; l < kLagged; ++l) own(k, l) = x[i - kLags[static_cast<size_t>(l)]];
    own(k, kLagged) = likely[i];
    own(k, kOwn) = x[i];
  }
  const double size = own.col(kOwn).norm() / std::sqrt(static_cast<double>(m));
  if (!(size > 0.0)) return foreseen;
  own /= size;
  std::array<MatrixXd, kFolds> zx;
  std::array<MatrixXd, kFolds> xx;
  for (int f = 0; f < kFolds; ++f) {
    zx[f] = MatrixXd::Zero(z_.cols(), kOwn + 1);
    xx[f] = MatrixXd::Zero(kOwn + 1, kOwn + 1);
  }
  for (Index k = 0; k < m; ++k) {
    if (!in_use_[static_cast<size_t>(k)]) continue;
    const int f = fold_[static_cast<size_t>(k)];
    zx[f].noalias() += z_.row(k).transpose() * own.row(k);
    xx[f].noalias() += own.row(k).transpose() * own.row(k);
  }
  MatrixXd all_zx = MatrixXd::Zero(z_.cols(), kOwn + 1), all_xx = MatrixXd::Zero(kOwn + 1, kOwn + 1);
  for (int f = 0; f < kFolds; ++f) {
    all_zx += zx[f];
    all_xx += xx[f];
  }
  std::array<VectorXd, kFolds> of_z;
  std::array<Eigen::Matrix<double, kOwn, 1>, kFolds> of_own;
  for (int f = 0; f < kFolds; ++f) {
    const MatrixXd b = all_zx - zx[f], s = all_xx - xx[f];
    const MatrixXd solved = without_[f].solve(b);
    Eigen::Matrix<double, kOwn, kOwn> H =
        s.topLeftCorner(kOwn, kOwn) - b.leftCols(kOwn).transpose() * solved.leftCols(kOwn);
    H.diagonal().array() += kRidge * static_cast<double>(m);
    of_own[f] = H.ldlt().solve(s.topRightCorner(kOwn, 1) -
                               b.leftCols(kOwn).transpose() * solved.col(kOwn));
    of_z[f] = solved.col(kOwn) - solved.leftCols(kOwn) * of_own[f];
  }
  double with = 0.0, self = 0.0;
  for (Index k = 0; k < m; ++k) {
    const size_t row = static_cast<size_t>(k);
    const int f = fold_[row];
    const double value = z_.row(k).dot(of_z[f]) + own.row(k).head<kOwn>().dot(of_own[f]);
    foreseen[rows_[row]] = value;
    if (!in_use_[row]) continue;
    with += value * own(k, kOwn);
    self += value * value;
  }
  double worth = self > 0.0 ? std::clamp(with / self, 0.0, 1.0) : 0.0;
  if (worth * with < kLeastForeseen * all_xx(kOwn, kOwn)) worth = 0.0;
  return worth * size * foreseen;
}

}  // namespace odmc
