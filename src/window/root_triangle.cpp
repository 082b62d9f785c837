#include "odmc/window/root_triangle.h"

#include <Eigen/Jacobi>
#include <algorithm>
#include <cmath>
#include <optional>

#include "odmc/window/householder.h"
#include "odmc/window/marginalization.h"

namespace odmc {
namespace {

// The anchored parameter hardly depends on the anchor; where it does, one step at a time.
constexpr double kMostFeedback = 0.5;

/// Right singular vectors of W by one-sided Jacobi rotations: Eigen's solvers allocate, and WᵀW
/// loses what is weak beside what is strong.
/// @param W n×n, becomes W V: columns are left singular vectors times singular values
void RotateColumns(Eigen::MatrixXd* W, Eigen::MatrixXd* V) {
  constexpr int kMostSweeps = 12;
  constexpr double kOrthogonal = 1e-14;
  const Eigen::Index n = W->cols();
  V->setIdentity(n, n);
  for (int sweep = 0; sweep < kMostSweeps; ++sweep) {
    bool turned = false;
    for (Eigen::Index i = 0; i < n; ++i) {
      for (Eigen::Index j = i + 1; j < n; ++j) {
        const double ii = W->col(i).squaredNorm(), jj = W->col(j).squaredNorm();
        const double ij = W->col(i).dot(W->col(j));
        if (std::abs(ij) <= kOrthogonal * std::sqrt(ii * jj)) continue;
        turned = true;
        Eigen::JacobiRotation<double> rotation;
        rotation.makeJacobi(ii, ij, jj);
        W->applyOnTheRight(i, j, rotation);
        V->applyOnTheRight(i, j, rotation);
      }
    }
    if (!turned) return;
  }
}

}  // namespace

void RootTriangle::Clear(int num_parameters) {
  columns_ = BorderColumns(num_parameters);
  stride_ = PaddedRow(columns_.size());
  data_.assign(static_cast<size_t>(columns_.pivots() * stride_), 0.0);
  scratch_.assign(data_.size(), 0.0);
}

RootTriangle& RootTriangle::operator=(const RootTriangle& other) {
  columns_ = other.columns_;
  stride_ = other.stride_;
  data_ = other.data_;
  scratch_.resize(other.scratch_.size());  // what is in it does not matter
  return *this;
}

void RootTriangle::Absorb(double* rows, int row_stride, int count) {
  AbsorbRows(data_.data(), stride_, rows, row_stride, count, columns_.pivots(), columns_.size());
}

void RootTriangle::AbsorbPriors(const Eigen::VectorXd& centre, const Eigen::VectorXd& sigma) {
  AbsorbPriorsFrom(BorderColumns::kParameters, centre, sigma);
}

void RootTriangle::AbsorbBiasPrior(const Eigen::VectorXd& centre, const Eigen::VectorXd& sigma) {
  AbsorbPriorsFrom(BorderColumns::kBias, centre, sigma);
}

/// |(x - centre) / sigma|² of the columns from `first` on.
void RootTriangle::AbsorbPriorsFrom(int first, const Eigen::VectorXd& centre,
                                    const Eigen::VectorXd& sigma) {
  std::fill(scratch_.begin(), scratch_.end(), 0.0);
  const auto rows = static_cast<int>(centre.size());
  for (int i = 0; i < rows; ++i) {
    double* prior = scratch_.data() + i * stride_;
    prior[first + i] = 1.0 / sigma[i];
    prior[columns_.rhs()] = -centre[i] / sigma[i];
  }
  Absorb(scratch_.data(), stride_, rows);
}

double RootTriangle::AddGradient(const std::vector<double>& gradient, double most_sigmas) {
  const int pivots = columns_.pivots();
  double* g = scratch_.data();
  std::copy_n(gradient.begin(), pivots, g);
  std::fill_n(g + pivots, stride_ - pivots, 0.0);
  return ForwardSubstitute(data_.data(), stride_, pivots, pivots, columns_.rhs(), g, most_sigmas);
}

void RootTriangle::DropBias() {
  std::fill_n(data_.begin(), BorderColumns::kParameters * stride_, 0.0);
}

void RootTriangle::Solve(int anchor_entry, double anchor, double* solution) const {
  // Once with the right-hand side, once with the anchor's column.
  const auto solve = [&](double of_anchor, double of_rhs, double* x) {
    x[columns_.anchor()] = of_anchor;
    x[columns_.rhs()] = of_rhs;
    std::fill_n(x + columns_.size(), kRowPadding, 0.0);
    BackSubstitute(data_.data(), stride_, columns_.pivots(), columns_.size(), x);
  };
  if (anchor_entry >= 0) {
    const int entry = BorderColumns::kParameters + anchor_entry;
    solve(1.0, 0.0, solution);
    const double slope = solution[entry];
    solve(0.0, 1.0, solution);
    if (std::abs(slope) < kMostFeedback) anchor = solution[entry] / (1.0 - slope);
  }
  solve(anchor, 1.0, solution);
}

bool RootTriangle::Covariance(Eigen::MatrixXd* covariance) const {
  const int n = columns_.n, first = BorderColumns::kParameters;
  // Columns of the inverse triangle as rows of a row-major buffer: T(j, i) of column j in row j.
  double* inverse = scratch_.data();
  for (int j = n - 1; j >= 0; --j) {
    if (!(std::abs(row(first + j)[first + j]) >= kLeastPivot)) return false;
  }
  // Row i of R T = I from the last to the first: T(i, j) = (1[i=j] - sum_k R(i, k) T(k, j)) / R(i,
  // i).
  for (int i = n - 1; i >= 0; --i) {
    const double* r = row(first + i) + first;
    double* t = inverse + i * stride_;
    std::fill_n(t, n, 0.0);
    t[i] = 1.0;
    for (int k = i + 1; k < n; ++k) {
      const double* of_k = inverse + k * stride_;
      for (int j = k; j < n; ++j) t[j] -= r[k] * of_k[j];
    }
    const double scale = 1.0 / r[i];
    for (int j = i; j < n; ++j) t[j] *= scale;
  }
  covariance->resize(n, n);
  for (int i = 0; i < n; ++i) {
    for (int j = i; j < n; ++j) {
      double sum = 0.0;
      for (int k = j; k < n; ++k) sum += inverse[i * stride_ + k] * inverse[j * stride_ + k];
      (*covariance)(i, j) = (*covariance)(j, i) = sum;
    }
  }
  return covariance->allFinite();
}

void RootTriangle::GetParameterRows(Eigen::MatrixXd* A, Eigen::MatrixXd* B) const {
  const int n = columns_.n;
  A->resize(n, n);
  B->resize(n, 2);
  for (int i = 0; i < n; ++i) {
    const double* r = row(BorderColumns::kParameters + i) + BorderColumns::kParameters;
    for (int j = 0; j < n; ++j) (*A)(i, j) = j < i ? 0.0 : r[j];
    for (int j = 0; j < 2; ++j) (*B)(i, j) = r[n + j];
  }
}

void RootTriangle::SetParameterRows(const Eigen::MatrixXd& A, const Eigen::MatrixXd& B) {
  const int n = columns_.n;
  for (int i = 0; i < n; ++i) std::fill_n(row(BorderColumns::kParameters + i), stride_, 0.0);
  std::fill(scratch_.begin(), scratch_.end(), 0.0);
  for (int i = 0; i < A.rows(); ++i) {
    double* r = scratch_.data() + i * stride_ + BorderColumns::kParameters;
    for (int j = 0; j < n; ++j) r[j] = A(i, j);
    for (int j = 0; j < 2; ++j) r[n + j] = B(i, j);
  }
  Absorb(scratch_.data(), stride_, static_cast<int>(A.rows()));
}

void RootTriangle::ScaleParameters(const Eigen::Ref<const Eigen::VectorXd>& scale, Workspace* w,
                                   Eigen::MatrixXd* root) {
  const int n = columns_.n;
  GetParameterRows(&w->A, &w->B);
  w->left = w->A;
  RotateColumns(&w->left, &w->right);
  DirectionScales(w->right, scale, &w->roots);
  root->setIdentity(n, n);
  // From the left: each direction's row [A B] is longer, so that no optimum is asked for.
  for (int i = 0; i < n; ++i) {
    const double more = w->roots[i] - 1.0;
    const double square = w->left.col(i).squaredNorm();
    root->noalias() += more * w->right.col(i) * w->right.col(i).transpose();
    w->A.noalias() += more * w->left.col(i) * w->right.col(i).transpose();
    if (square < kLeastPivot * kLeastPivot) continue;  // nobody measured it
    w->shares.noalias() = (more / square) * w->left.col(i).transpose() * w->B;
    w->B.noalias() += w->left.col(i) * w->shares;
  }
  SetParameterRows(w->A, w->B);
}

void RootTriangle::LetWalk(const Eigen::Ref<const Eigen::VectorXd>& direction, double variance,
                           Workspace* w) {
  GetParameterRows(&w->A, &w->B);
  w->roots.noalias() = w->A * direction;
  const std::optional<double> gain = FadingGain(w->roots.squaredNorm(), variance);
  if (!gain) return;
  w->along.noalias() = *gain * w->roots.transpose() * w->A;
  w->shares.noalias() = *gain * w->roots.transpose() * w->B;
  w->A.noalias() -= w->roots * w->along;
  w->B.noalias() -= w->roots * w->shares;
  SetParameterRows(w->A, w->B);
}

void RootTriangle::ParameterNormal(Workspace* workspace, Eigen::MatrixXd* normal) const {
  const int n = columns_.n;
  GetParameterRows(&workspace->A, &workspace->B);
  normal->resize(n, n + 2);
  normal->leftCols(n).noalias() = workspace->A.transpose() * workspace->A;
  normal->rightCols(2).noalias() = workspace->A.transpose() * workspace->B;
}

bool RootTriangle::AddNormal(const Eigen::MatrixXd& difference, Workspace* workspace) {
  const int n = columns_.n;
  ParameterNormal(workspace, &workspace->normal);
  workspace->normal += difference;
  workspace->A = workspace->normal.leftCols(n);
  workspace->llt.compute(workspace->A);
  if (workspace->llt.info() != Eigen::Success) return false;
  workspace->B = workspace->normal.rightCols(2);
  workspace->llt.matrixL().solveInPlace(workspace->B);
  const Eigen::MatrixXd& U = workspace->llt.matrixLLT();
  if (!workspace->B.allFinite() || !U.allFinite()) return false;
  for (int i = 0; i < n; ++i) {
    double* r = row(BorderColumns::kParameters + i) + BorderColumns::kParameters;
    for (int j = i; j < n; ++j) r[j] = U(i, j);
    for (int j = 0; j < 2; ++j) r[n + j] = workspace->B(i, j);
  }
  return true;
}

}  // namespace odmc
