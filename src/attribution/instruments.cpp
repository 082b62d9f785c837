#include "odmc/attribution/instruments.h"

#include <Eigen/SVD>
#include <algorithm>
#include <array>
#include <cmath>
#include <functional>

#include "odmc/estimator/gates.h"

namespace odmc {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

// Samples of 40 ms: beyond twice the filter's half window, and no further than a manoeuvre.
constexpr std::array<int, 3> kLags = {3, 5, 8};
constexpr int kSignals = 17;
constexpr double kRidge = 1e-3;         // of a signal's sum of squares
constexpr double kLeastForeseen = 0.2;  // of a column's sum of squares
constexpr double kFoldBlock_s = 1.0;    // a manoeuvre spans more than one

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

int Instruments::FoldAt(double t_s) {
  const int fold = static_cast<int>(std::fmod(std::floor(t_s / kFoldBlock_s), kFolds));
  return fold < 0 ? fold + kFolds : fold;
}

Instruments::Instruments(const ThinnedFlight& flight, const Vehicle& file_vehicle)
    : likely_flight_(flight.Moving({})) {
  const int n = flight.size();
  sees_.assign(static_cast<size_t>(n), false);
  std::array<std::vector<int>, kFolds> in_use, held_out;
  int run = 0;
  for (int i = 0; i < n; ++i) {
    run = flight.next(i) ? run + 1 : 0;
    if (run < kReach) continue;
    sees_[static_cast<size_t>(i)] = true;
    const auto fold = static_cast<size_t>(FoldAt(flight.sample(i).t_s));
    (flight.held_out(i) ? held_out : in_use)[fold].push_back(i);
  }
  for (size_t f = 0; f < kFolds; ++f) {
    folds_[f] = {static_cast<Index>(rows_.size()), static_cast<Index>(in_use[f].size()),
                 static_cast<Index>(in_use[f].size() + held_out[f].size())};
    rows_.insert(rows_.end(), in_use[f].begin(), in_use[f].end());
    rows_.insert(rows_.end(), held_out[f].begin(), held_out[f].end());
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
  std::array<MatrixXd, kFolds> gram;
  MatrixXd all = MatrixXd::Zero(z_.cols(), z_.cols());
  for (size_t f = 0; f < kFolds; ++f) {
    const auto own = z_.middleRows(folds_[f].first, folds_[f].in_use);
    gram[f].noalias() = own.transpose() * own;
    all += gram[f];
  }
  for (size_t f = 0; f < kFolds; ++f) {
    MatrixXd others = all - gram[f];
    others.diagonal().array() += kRidge * static_cast<double>(m) + 1e-300;
    without_.emplace_back(others);
  }
  likely_flight_ = flight.Moving(LikelyMotion(flight));
}

std::vector<FilteredMotion> Instruments::LikelyMotion(const ThinnedFlight& flight) const {
  std::vector<FilteredMotion> samples;
  for (int i = 0; i < flight.size(); ++i) samples.push_back(flight.sample(i));
  if (samples.empty()) return samples;
  // Every number of a sample's motion, by a function that gives it to read and to write.
  std::vector<std::function<double&(FilteredMotion&)>> numbers;
  for (Index k = 0; k < 3; ++k) {
    for (Index l = 0; l < 3; ++l) {
      numbers.emplace_back([k, l](FilteredMotion& s) -> double& { return s.R_WS(k, l); });
    }
    numbers.emplace_back([k](FilteredMotion& s) -> double& { return s.p_WS[k]; });
    numbers.emplace_back([k](FilteredMotion& s) -> double& { return s.v_WS[k]; });
    numbers.emplace_back([k](FilteredMotion& s) -> double& { return s.a_WS[k]; });
    numbers.emplace_back([k](FilteredMotion& s) -> double& { return s.w_S[k]; });
    numbers.emplace_back([k](FilteredMotion& s) -> double& { return s.w_dot_S[k]; });
  }
  for (Index j = 0; j < samples.front().rotors.speed.size(); ++j) {
    numbers.emplace_back([j](FilteredMotion& s) -> double& { return s.rotors.speed[j]; });
    numbers.emplace_back([j](FilteredMotion& s) -> double& { return s.rotors.speed_squared[j]; });
    numbers.emplace_back([j](FilteredMotion& s) -> double& { return s.rotors.acceleration[j]; });
    numbers.emplace_back(
        [j](FilteredMotion& s) -> double& { return s.rotors.speed_squared_rate[j]; });
  }
  MatrixXd x(flight.size(), static_cast<Index>(numbers.size()));
  for (Index i = 0; i < x.rows(); ++i) {
    for (Index k = 0; k < x.cols(); ++k) {
      x(i, k) = numbers[static_cast<size_t>(k)](samples[static_cast<size_t>(i)]);
    }
  }
  const MatrixXd likely = Foreseen(x, MatrixXd::Zero(x.rows(), x.cols()));
  for (Index i = 0; i < x.rows(); ++i) {
    for (Index k = 0; k < x.cols(); ++k) {
      numbers[static_cast<size_t>(k)](samples[static_cast<size_t>(i)]) = likely(i, k);
    }
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
  return ForeseenBatch(column, likely);
}

MatrixXd Instruments::Foreseen(const MatrixXd& columns, const MatrixXd& likely) const {
  constexpr Index kBatch = 16;
  MatrixXd foreseen(columns.rows(), columns.cols());
  for (Index c = 0; c < columns.cols(); c += kBatch) {
    const Index size = std::min(kBatch, columns.cols() - c);
    foreseen.middleCols(c, size) =
        ForeseenBatch(columns.middleCols(c, size), likely.middleCols(c, size));
  }
  return foreseen;
}

/// Columns that are foreseen at once, those that are zero left out.
struct Instruments::Batch {
  static constexpr Index kLagged = static_cast<Index>(kLags.size());
  static constexpr Index kOwn = kLagged + 1;
  static constexpr Index kWidth = kOwn + 1;

  std::vector<Index> acting;  // which they are
  std::vector<double> size;   // root mean square
  // Of each column, of unit size, its own past, what it would be in the likely motion, then itself.
  MatrixXd own;

  Index num_columns() const { return static_cast<Index>(acting.size()); }
};

/// Their sums of products, by fold and of all folds: with the instruments, and among a column's
/// own.
struct Instruments::Sums {
  std::array<MatrixXd, kFolds> zx, xx;
  MatrixXd all_zx, all_xx;
};

/// What foresees each column: of the instruments, and of what is its own.
struct Instruments::Weights {
  MatrixXd of_z, of_own;
};

Instruments::Batch Instruments::BatchOf(const MatrixXd& columns, const MatrixXd& likely) const {
  const auto m = static_cast<Index>(rows_.size());
  Batch batch;
  for (Index c = 0; c < columns.cols(); ++c) {
    double sum = 0.0;
    for (const int i : rows_) sum += columns(i, c) * columns(i, c);
    if (!(sum > 0.0)) continue;
    batch.acting.push_back(c);
    batch.size.push_back(std::sqrt(sum / static_cast<double>(m)));
  }
  batch.own.resize(m, batch.num_columns() * Batch::kWidth);
  for (Index c = 0; c < batch.num_columns(); ++c) {
    const auto x = columns.col(batch.acting[static_cast<size_t>(c)]);
    const auto of_likely = likely.col(batch.acting[static_cast<size_t>(c)]);
    const double scale = 1.0 / batch.size[static_cast<size_t>(c)];
    for (Index k = 0; k < m; ++k) {
      const int i = rows_[static_cast<size_t>(k)];
      for (Index l = 0; l < Batch::kLagged; ++l) {
        batch.own(k, c * Batch::kWidth + l) = scale * x[i - kLags[static_cast<size_t>(l)]];
      }
      batch.own(k, c * Batch::kWidth + Batch::kLagged) = scale * of_likely[i];
      batch.own(k, c * Batch::kWidth + Batch::kOwn) = scale * x[i];
    }
  }
  return batch;
}

Instruments::Sums Instruments::SumsOf(const Batch& batch) const {
  constexpr Index kWidth = Batch::kWidth;
  Sums sums;
  sums.all_zx = MatrixXd::Zero(z_.cols(), batch.own.cols());
  sums.all_xx = MatrixXd::Zero(kWidth, batch.own.cols());
  for (size_t f = 0; f < kFolds; ++f) {
    const auto rows = batch.own.middleRows(folds_[f].first, folds_[f].in_use);
    sums.zx[f].noalias() = z_.middleRows(folds_[f].first, folds_[f].in_use).transpose() * rows;
    sums.xx[f].resize(kWidth, batch.own.cols());
    for (Index c = 0; c < batch.num_columns(); ++c) {
      const auto of_column = rows.middleCols(c * kWidth, kWidth);
      sums.xx[f].middleCols(c * kWidth, kWidth) = of_column.transpose() * of_column;
    }
    sums.all_zx += sums.zx[f];
    sums.all_xx += sums.xx[f];
  }
  return sums;
}

Instruments::Weights Instruments::WeightsWithout(size_t f, const Sums& sums) const {
  constexpr Index kLagged = Batch::kLagged, kOwn = Batch::kOwn, kWidth = Batch::kWidth;
  const Index n = sums.all_xx.cols() / kWidth;
  const MatrixXd b = sums.all_zx - sums.zx[f];
  const MatrixXd solved = without_[f].solve(b);
  Weights weights{MatrixXd(z_.cols(), n), MatrixXd(kOwn, n)};
  for (Index c = 0; c < n; ++c) {
    const MatrixXd s =
        sums.all_xx.middleCols(c * kWidth, kWidth) - sums.xx[f].middleCols(c * kWidth, kWidth);
    const auto b_c = b.middleCols(c * kWidth, kWidth);
    const auto solved_c = solved.middleCols(c * kWidth, kWidth);
    Eigen::Matrix<double, kOwn, kOwn> H =
        s.topLeftCorner(kOwn, kOwn) - b_c.leftCols(kOwn).transpose() * solved_c.leftCols(kOwn);
    H.diagonal().array() += kRidge * static_cast<double>(rows_.size());
    const Eigen::Matrix<double, kOwn, 1> g =
        s.topRightCorner(kOwn, 1) - b_c.leftCols(kOwn).transpose() * solved_c.col(kOwn);
    auto own = weights.of_own.col(c);
    own = H.ldlt().solve(g);
    // What it would be in the likely motion counts for it or not at all. That motion is foreseen
    // fold by fold, too, from rows of this one among others: a weight below zero undoes that, and
    // gives the fold back what is its own.
    if (own[kLagged] < 0.0) {
      own << H.topLeftCorner<kLagged, kLagged>().ldlt().solve(g.head<kLagged>()), 0.0;
    }
    weights.of_z.col(c) = solved_c.col(kOwn) - solved_c.leftCols(kOwn) * own;
  }
  return weights;
}

MatrixXd Instruments::ValueByFolds(const Batch& batch, const Sums& sums) const {
  MatrixXd value(batch.own.rows(), batch.num_columns());
  for (size_t f = 0; f < kFolds; ++f) {
    const auto [first, in_use, size] = folds_[f];
    const Weights weights = WeightsWithout(f, sums);
    auto of_fold = value.middleRows(first, size);
    of_fold.noalias() = z_.middleRows(first, size) * weights.of_z;
    for (Index c = 0; c < batch.num_columns(); ++c) {
      of_fold.col(c).noalias() +=
          batch.own.block(first, c * Batch::kWidth, size, Batch::kOwn) * weights.of_own.col(c);
    }
  }
  return value;
}

double Instruments::WorthOf(const Eigen::Ref<const VectorXd>& value,
                            const Eigen::Ref<const VectorXd>& itself, double square) const {
  double with = 0.0, self = 0.0;
  for (const Fold& fold : folds_) {
    const auto in_use = value.segment(fold.first, fold.in_use);
    with += in_use.dot(itself.segment(fold.first, fold.in_use));
    self += in_use.squaredNorm();
  }
  const double worth = self > 0.0 ? std::clamp(with / self, 0.0, 1.0) : 0.0;
  return worth * with < kLeastForeseen * square ? 0.0 : worth;
}

MatrixXd Instruments::ForeseenBatch(const MatrixXd& columns, const MatrixXd& likely) const {
  MatrixXd foreseen = MatrixXd::Zero(columns.rows(), columns.cols());
  const Batch batch = BatchOf(columns, likely);
  if (batch.num_columns() == 0) return foreseen;
  const Sums sums = SumsOf(batch);
  const MatrixXd value = ValueByFolds(batch, sums);
  for (Index c = 0; c < batch.num_columns(); ++c) {
    const Index itself = c * Batch::kWidth + Batch::kOwn;
    const double worth =
        WorthOf(value.col(c), batch.own.col(itself), sums.all_xx(Batch::kOwn, itself));
    for (Index k = 0; k < value.rows(); ++k) {
      foreseen(rows_[static_cast<size_t>(k)], batch.acting[static_cast<size_t>(c)]) =
          worth * batch.size[static_cast<size_t>(c)] * value(k, c);
    }
  }
  return foreseen;
}

}  // namespace odmc
