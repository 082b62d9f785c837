#pragma once

#include <Eigen/Core>

#include "odmc/window/chain_front.h"
#include "odmc/window/root_triangle.h"

namespace odmc {

/// What all that has left the window says about bias and parameters, and how that changes later.
/// Rows about parameters alone simply add up, whatever was eliminated before; so roots that hold
/// the past learn of a change by the difference of its normal equations.
class ChainPast {
 public:
  /// Knows nothing of `n` parameters.
  void Clear(int n);

  const RootTriangle& rows() const { return rows_; }
  const BorderColumns& columns() const { return rows_.columns(); }
  int num_parameters() const { return rows_.columns().n; }
  /// Takes rows over BorderColumns in; overwrites them.
  void Absorb(double* rows, int stride, int count) { rows_.Absorb(rows, stride, count); }
  /// The oldest front has left the chain.
  void Absorb(const ChainFront& front, FrontScratch* scratch) { front.LeaveTo(&rows_, scratch); }
  void DropBias() { rows_.DropBias(); }

  /// RescalePrior() of it. @returns the root of the scale, until the next call
  const Eigen::MatrixXd& Scale(const Eigen::Ref<const Eigen::VectorXd>& scale);
  /// The same for a past that no root is to hold before it starts anew from it.
  const Eigen::MatrixXd& ScaleUntold(const Eigen::Ref<const Eigen::VectorXd>& scale);
  /// LetPriorWalk() of it.
  void LetWalk(const Eigen::Ref<const Eigen::VectorXd>& direction, double variance);

  /// True if it has changed since ForgetChange().
  bool has_changed() const { return has_changed_; }
  /// Tells a root that holds it of the change. @returns false, unchanged, where rounding leaves no
  /// positive sum
  bool TellChange(RootTriangle* root) { return root->AddNormal(change_, &workspace_); }
  /// All roots know.
  void ForgetChange();

  /// Information about the parameters alone (n×n), until the next call.
  const Eigen::MatrixXd& Information();

 private:
  template <typename Change>
  void ChangeBy(const Change& change);

  RootTriangle rows_;
  Eigen::MatrixXd change_;  // of its normal equations that the roots do not know yet
  bool has_changed_ = false;
  RootTriangle::Workspace workspace_;
  Eigen::MatrixXd normal_, scale_root_, information_;
};

}  // namespace odmc
