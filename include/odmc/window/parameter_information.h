#pragma once

#include <Eigen/Core>
#include <vector>

#include "odmc/window/window.h"

namespace odmc {

/// For the reference solver: information (inverse covariance) of the parameters alone, all states
/// of the window and the prior taken into account: the chain of states is eliminated oldest first,
/// and what an elimination hands to the next keyframe is kept. An update redoes only the newest
/// `fresh` keyframes and those the kept part no longer fits; the whole chain when parameters moved
/// by more than `relinearize`.
class ParameterInformation {
 public:
  /// @param fresh number of newest keyframes that are redone at every call
  explicit ParameterInformation(int fresh = 3) : fresh_(fresh) {}

  /// Forgets what is kept.
  void Forget() { messages_.clear(); }

  /// Scales what is kept by what RescalePrior() returns.
  void Rescale(const Eigen::MatrixXd& root);

  /// @returns the n×n information with respect to eta at the window's present estimate, with the
  ///   parameters' own priors
  const Eigen::MatrixXd& Update(const Window& window, const Eigen::VectorXd& relinearize);

  /// Information of the newest state (12), its bias (6, if it has one) and the parameters (n) at
  /// the last Update(); empty without a state.
  const Eigen::MatrixXd& newest() const { return newest_; }

 private:
  /// What all keyframes before one say about it: rows over its state (12), its bias (6, if it has
  /// one) and the parameters (n).
  struct Message {
    std::int64_t id = -1;
    Eigen::MatrixXd rows;
  };

  bool Reusable(const Window& window, const Eigen::VectorXd& relinearize) const;

  int fresh_;
  std::vector<Message> messages_;
  Eigen::VectorXd eta_;
  Eigen::MatrixXd information_, newest_;
};

}  // namespace odmc
