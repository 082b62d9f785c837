#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <vector>

namespace odmc {

/// Columns of everything that is shared by the chain of states: the bias in force (6, zero without
/// an IMU), the parameters (n), and the right-hand side. Biases and parameters count from zero, not
/// from a linearization point, so that rows linearized at different points add up.
struct BorderColumns {
  explicit BorderColumns(int num_parameters) : n(num_parameters) {}

  static constexpr int kBias = 0, kParameters = 6;
  int n;
  int rhs() const { return kParameters + n; }
  int size() const { return kParameters + n + 1; }
};

/// The root of the elimination: what rows say about the bias in force and the parameters once all
/// states are eliminated, as an upper triangle [R d], |R x + d|². The bias comes first, so that it
/// can leave by dropping its rows.
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

  /// Forgets the bias; what the rest says of the parameters stays.
  void DropBias();

  /// The optimum: bias (6), parameters (n), then 1. What nobody measured is 0.
  void Solve(double* solution) const;

  /// Covariance of the parameters (n×n), the bias taken into account.
  /// @returns false if a direction has no information
  bool Covariance(Eigen::MatrixXd* covariance) const;

  /// What it says of the parameters alone, [A b] (n×n, n).
  void GetParameterRows(Eigen::MatrixXd* A, Eigen::VectorXd* b) const;
  void SetParameterRows(const Eigen::MatrixXd& A, const Eigen::VectorXd& b);

  /// Buffers of AddNormal().
  struct Workspace {
    Eigen::MatrixXd A, normal;
    Eigen::VectorXd b;
    Eigen::LLT<Eigen::MatrixXd, Eigen::Upper> llt;
  };

  /// The normal equations of the parameters, [A b]ᵀ[A b] ((n+1)×(n+1), upper triangle).
  void ParameterNormal(Workspace* workspace, Eigen::MatrixXd* normal) const;

  /// Adds to them. @returns false, unchanged, if the sum is not positive
  bool AddNormal(const Eigen::MatrixXd& difference, Workspace* workspace);

 private:
  BorderColumns columns_{0};
  int stride_ = 0;
  std::vector<double> data_;
  mutable std::vector<double> scratch_;
};

}  // namespace odmc
