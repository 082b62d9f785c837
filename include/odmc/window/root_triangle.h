#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <limits>
#include <vector>

namespace odmc {

/// Columns of everything that is shared by the chain of states: the bias in force (6, zero without
/// an IMU), the parameters (n), the anchor (1, see Window) and the right-hand side. Biases and
/// parameters count from zero, not from a linearization point, so that rows linearized at different
/// points add up.
struct BorderColumns {
  explicit BorderColumns(int num_parameters) : n(num_parameters) {}

  static constexpr int kBias = 0, kParameters = 6;
  int n;
  int pivots() const { return kParameters + n; }
  int anchor() const { return kParameters + n; }
  int rhs() const { return kParameters + n + 1; }
  int size() const { return kParameters + n + 2; }
};

/// The root of the elimination: what rows say about the bias in force and the parameters once all
/// states are eliminated, as an upper triangle [R c d], |R x + c a + d|², a the anchor. The bias
/// comes first, so that it can leave by dropping its rows.
class RootTriangle {
 public:
  explicit RootTriangle(int num_parameters = 0) { Clear(num_parameters); }
  RootTriangle(const RootTriangle& other) { *this = other; }
  RootTriangle& operator=(const RootTriangle& other);

  /// Knows nothing.
  void Clear(int num_parameters);

  const BorderColumns& columns() const { return columns_; }
  int stride() const { return stride_; }
  double* row(int i) { return data_.data() + i * stride_; }
  const double* row(int i) const { return data_.data() + i * stride_; }

  /// Takes rows over BorderColumns in; overwrites them.
  void Absorb(double* rows, int row_stride, int count);

  /// Takes in |(x - centre) / sigma|² of the parameters (n each).
  void AbsorbPriors(const Eigen::VectorXd& centre, const Eigen::VectorXd& sigma);
  /// The same of the bias (6 each).
  void AbsorbBiasPrior(const Eigen::VectorXd& centre, const Eigen::VectorXd& sigma);

  /// Adds gᵀx, g over bias and parameters, to the sum of squares (halved).
  /// @param most_sigmas by which it moves the optimum in any direction: what lies beyond is left
  ///   out, so that a direction that is hardly known does not run away
  /// @returns how far its optimum moves at most [sigmas of any direction]
  double AddGradient(const std::vector<double>& gradient,
                     double most_sigmas = std::numeric_limits<double>::infinity());

  /// Forgets the bias; what the rest says of the parameters stays.
  void DropBias();

  /// The optimum: bias (6), parameters (n), anchor, 1. What nobody measured is 0.
  /// @param anchor_entry of the parameters, which the anchor follows: it is where solving with it
  ///   gives the same parameter; -1: it stays at `anchor`
  /// @param solution columns, and room for kRowPadding more
  void Solve(int anchor_entry, double anchor, double* solution) const;

  /// Covariance of the parameters (n×n), the bias taken into account.
  /// @returns false if a direction has no information
  bool Covariance(Eigen::MatrixXd* covariance) const;

  /// What it says of the parameters alone, [A B] (n×n, n×2: anchor, right-hand side).
  void GetParameterRows(Eigen::MatrixXd* A, Eigen::MatrixXd* B) const;
  void SetParameterRows(const Eigen::MatrixXd& A, const Eigen::MatrixXd& B);

  /// Buffers of AddNormal().
  struct Workspace {
    Eigen::MatrixXd A, B, normal;
    Eigen::LLT<Eigen::MatrixXd, Eigen::Upper> llt;
    Eigen::MatrixXd left, right;
    Eigen::VectorXd roots;
    Eigen::RowVector2d shares;
    Eigen::RowVectorXd along;
  };

  /// Scales what it says of the parameters alone as RescalePrior() does; its optimum stays.
  /// @param root becomes the root of the scale (n×n)
  void ScaleParameters(const Eigen::Ref<const Eigen::VectorXd>& scale, Workspace* workspace,
                       Eigen::MatrixXd* root);

  /// What it says of the parameters alone fades along a direction as by LetPriorWalk().
  void LetWalk(const Eigen::Ref<const Eigen::VectorXd>& direction, double variance,
               Workspace* workspace);

  /// The normal equations of the parameters, Aᵀ[A B] (n×(n+2)).
  void ParameterNormal(Workspace* workspace, Eigen::MatrixXd* normal) const;

  /// Adds to them. @returns false, unchanged, if the sum is not positive
  bool AddNormal(const Eigen::MatrixXd& difference, Workspace* workspace);

 private:
  void AbsorbPriorsFrom(int first, const Eigen::VectorXd& centre, const Eigen::VectorXd& sigma);

  BorderColumns columns_{0};
  int stride_ = 0;
  std::vector<double> data_;
  mutable std::vector<double> scratch_;
};

}  // namespace odmc
