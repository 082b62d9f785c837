#include "odmc/window/chain_past.h"

namespace odmc {

void ChainPast::Clear(int n) {
  rows_.Clear(n);
  change_.setZero(n, n + 2);
  has_changed_ = false;
}

template <typename Change>
void ChainPast::ChangeBy(const Change& change) {
  rows_.ParameterNormal(&workspace_, &normal_);
  change_ -= normal_;
  change();
  rows_.ParameterNormal(&workspace_, &normal_);
  change_ += normal_;
  has_changed_ = true;
}

const Eigen::MatrixXd& ChainPast::Scale(const Eigen::Ref<const Eigen::VectorXd>& scale) {
  ChangeBy([&] { rows_.ScaleParameters(scale, &workspace_, &scale_root_); });
  return scale_root_;
}

const Eigen::MatrixXd& ChainPast::ScaleUntold(const Eigen::Ref<const Eigen::VectorXd>& scale) {
  rows_.ScaleParameters(scale, &workspace_, &scale_root_);
  return scale_root_;
}

void ChainPast::LetWalk(const Eigen::Ref<const Eigen::VectorXd>& direction, double variance) {
  ChangeBy([&] { rows_.LetWalk(direction, variance, &workspace_); });
}

void ChainPast::ForgetChange() {
  change_.setZero();
  has_changed_ = false;
}

const Eigen::MatrixXd& ChainPast::Information() {
  rows_.ParameterNormal(&workspace_, &normal_);
  information_ = normal_.leftCols(num_parameters());
  return information_;
}

}  // namespace odmc
