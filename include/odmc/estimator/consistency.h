#pragma once

#include <Eigen/Core>
#include <vector>

#include "odmc/estimator/thirds_consistency.h"

namespace odmc {

/// How much larger the parameters' errors are than white noise would make them. Residuals of a
/// model that lacks something are serially correlated, and an inverse information that ignores this
/// is too small by a factor of 3 to 10 (model.md section 5). Here the scores Jᵀr of the factors
/// that left the window are summed over blocks of time; the spread of the block sums, mapped
/// through the information, is the variance the estimate really has (a sandwich estimate with batch
/// means). Holds for any cause: correlation, wrong noise sizes, robust losses. Blocks merge as the
/// flight grows; all memory is taken in the beginning.
class Consistency {
 public:
  explicit Consistency(int num_parameters);

  /// Entries whose value follows the flight: each block is judged about the value of its time.
  void SetWalking(const std::vector<int>& entries);

  /// One interval's score at the estimate `eta`.
  void Add(double dt, const Eigen::Ref<const Eigen::VectorXd>& score,
           const Eigen::Ref<const Eigen::VectorXd>& eta);

  /// True when a block is full: CloseBlock() is then due.
  bool BlockIsFull() const { return block_s_ >= block_length_s_; }

  /// Ends the block; `left` is the information of everything that has left the window so far (n×n).
  void CloseBlock(const Eigen::MatrixXd& left);

  /// Tells that a walk has made `before`, the information of what left, to `after` (n×n each).
  void Walked(const Eigen::MatrixXd& before, const Eigen::MatrixXd& after);

  /// Scales everything so far by what RescalePrior() returns.
  void Rescale(const Eigen::MatrixXd& root);

  /// Factor on each parameter's standard deviation (n), >= 0.5: below 1 where the assumed noise was
  /// larger than the flight's. The share of the variance that is the priors' stays as it is: of
  /// what a flight does not show, the factor is 1.
  /// @param eta present estimate; @param covariance inverse of its information (n×n)
  /// @param prior_sigma of the priors in that information (n)
  const Eigen::VectorXd& Inflation(const Eigen::Ref<const Eigen::VectorXd>& eta,
                                   const Eigen::MatrixXd& covariance,
                                   const Eigen::VectorXd& prior_sigma);

  /// What each third of the flight says by itself; empty while there are fewer than six blocks.
  /// @param eta present estimate
  /// @param prior_sigma of each entry: a third that says nothing stays at the estimate
  std::vector<ThirdOfFlight> Thirds(const Eigen::Ref<const Eigen::VectorXd>& eta,
                                    const Eigen::VectorXd& prior_sigma);

 private:
  void ApplyRescaling();
  void Merge();
  /// From one estimate to another, as far as a block's score has to be taken there.
  template <typename Difference>
  void Shift(const Difference& difference, Eigen::VectorXd* shift) const;

  struct Block {
    Eigen::VectorXd score, eta;
    Eigen::MatrixXd information;
    double length_s = 0.0;
  };

  int n_;
  std::vector<int> walking_;
  double block_length_s_ = 0.25;
  double block_s_ = 0.0;
  Eigen::VectorXd score_, eta_sum_;
  Eigen::MatrixXd left_;
  std::vector<Block> blocks_;  // the first num_blocks_ of them
  int num_blocks_ = 0;
  // What Rescale() did since the blocks were last used, and scratch.
  bool rescaled_ = false;
  Eigen::MatrixXd pending_root_, pending_scale_;
  Eigen::MatrixXd scale_, half_, steps_;
  Eigen::VectorXd scaled_, sum_, shift_, sum_of_squares_, white_, flown_, inflation_;
};

}  // namespace odmc
