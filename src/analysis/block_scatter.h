#pragma once

#include <Eigen/Core>
#include <vector>

namespace odmc {

/// A linear regression, as mean powers.
struct Regression {
  using Terms = Eigen::VectorXd;
  using Gram = Eigen::MatrixXd;

  double share = 1.0;  ///< of all data
  Gram gram;           ///< of the regressors, what is known to be noise taken off
  Gram noise;          ///< of that noise
  Terms right;         ///< of regressors and response
  double power = 0.0;  ///< of the response
};

/// Variance of coefficients where excitation and noise come in bursts.
struct BlockScatter {
  /// Of excitation and noise that are stationary within each block, and may differ between them.
  Regression::Terms variance;
  Regression::Terms stationary;  ///< the same, were they stationary over all data
  /// Sum of squares by which the blocks pull the coefficients to and fro; and what it would be were
  /// `variance` right.
  Regression::Terms found, expected;
  /// Degrees of freedom of `found`: blocks that count, less one; 0 where one block carries all.
  Regression::Terms freedom;
};

/// What blocks that follow each other share.
struct BlockOverlap {
  double variance = 1.0;  ///< of a sum over blocks, over that of blocks that are independent
  double freedom = 1.0;   ///< degrees of freedom of a sum of squares, over the same
};

/// @param all the regression of all data; gram positive definite
/// @param blocks the same of each block of neighbouring data, which make up `all`
/// @param independent complex values in all data that are independent of each other
BlockScatter ScatterOf(const Regression& all, const std::vector<Regression>& blocks,
                       double independent, const BlockOverlap& overlap);

/// What `BlockScatter`s of several bands say together of one coefficient: bursts are the flight's,
/// and what each band alone says of them is uncertain.
class PooledScatter {
 public:
  /// Adds a band's coefficient `i`.
  /// @param scale of variance: from the coefficient to what it is taken for
  void Add(const BlockScatter& scatter, Eigen::Index i, double scale);
  /// By how much the variance is larger than that of a stationary flight; 1: nothing is known.
  double bursts() const { return freedom_ > 0.0 ? bursts_ / freedom_ : 1.0; }
  /// Found over expected; 1: nothing is known.
  double ratio() const { return freedom_ > 0.0 ? ratio_ / freedom_ : 1.0; }
  double freedom() const { return freedom_; }
  /// Variance of the band that was added as `k`th, for three sigma that hold as often as those of a
  /// normal variable whose variance is known.
  /// @param least of a stationary flight
  double Variance(size_t k, double least) const;

 private:
  std::vector<double> stationary_;
  double bursts_ = 0.0, ratio_ = 0.0, freedom_ = 0.0;
};

}  // namespace odmc
