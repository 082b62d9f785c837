#include "odmc/estimator/consistency.h"

#include <algorithm>
#include <cmath>

namespace odmc {
namespace {

constexpr int kMaxBlocks = 128;
constexpr double kLeastInflation = 0.5;
constexpr int kMinGroups = 8;         // fewer block sums than this say nothing about a variance
constexpr double kPriorGroups = 8.0;  // weight of "white" against a small sample of block sums

}  // namespace

void Consistency::Add(double dt, const Eigen::Ref<const Eigen::VectorXd>& score,
                      const Eigen::Ref<const Eigen::VectorXd>& eta) {
  if (block_s_ == 0.0) {
    score_ = Eigen::VectorXd::Zero(n_);
    eta_sum_ = Eigen::VectorXd::Zero(n_);
  }
  score_ += score;
  eta_sum_ += dt * eta;
  block_s_ += dt;
}

void Consistency::CloseBlock(const Eigen::MatrixXd& left) {
  ApplyRescaling();
  if (left_.size() == 0) left_ = Eigen::MatrixXd::Zero(n_, n_);
  // The first block's share of the information includes the prior; its score at the prior's centre
  // is zero there, and elsewhere the linear correction below accounts for it.
  blocks_.push_back({score_, eta_sum_ / block_s_, left - left_, block_s_});
  left_ = left;
  block_s_ = 0.0;
  if (static_cast<int>(blocks_.size()) < kMaxBlocks) return;
  std::vector<Block> merged;
  for (size_t i = 0; i + 1 < blocks_.size(); i += 2) {
    const Block &a = blocks_[i], &b = blocks_[i + 1];
    const double length = a.length_s + b.length_s;
    // Scores of both halves at one common estimate.
    const Eigen::VectorXd eta = (a.length_s * a.eta + b.length_s * b.eta) / length;
    merged.push_back(
        {a.score + a.information * (eta - a.eta) + b.score + b.information * (eta - b.eta), eta,
         a.information + b.information, length});
  }
  blocks_ = std::move(merged);
  block_length_s_ *= 2.0;
}

void Consistency::Rescale(const Eigen::MatrixXd& root) {
  scale_.noalias() = root * root;
  if (score_.size() > 0) {
    scaled_.noalias() = scale_ * score_;
    score_.swap(scaled_);
  }
  if (left_.size() > 0) {
    half_.noalias() = root * left_;
    left_.noalias() = half_ * root;
  }
  // There may be a hundred blocks, and only their next use needs them.
  if (blocks_.empty()) return;
  if (!rescaled_) {
    pending_root_ = root;
    pending_scale_ = scale_;
    rescaled_ = true;
    return;
  }
  half_.noalias() = root * pending_root_;
  pending_root_.swap(half_);
  half_.noalias() = scale_ * pending_scale_;
  pending_scale_.swap(half_);
}

void Consistency::ApplyRescaling() {
  if (!rescaled_) return;
  rescaled_ = false;
  for (Block& block : blocks_) {
    scaled_.noalias() = pending_scale_ * block.score;
    block.score.swap(scaled_);
    half_.noalias() = pending_root_ * block.information;
    block.information.noalias() = half_ * pending_root_.transpose();
  }
}

Eigen::VectorXd Consistency::Inflation(const Eigen::VectorXd& eta,
                                       const Eigen::MatrixXd& covariance) {
  ApplyRescaling();
  // Until there are enough blocks to judge by, the white value; then whatever they show.
  const bool enough = blocks_.size() > kMinGroups;
  Eigen::VectorXd inflation = Eigen::VectorXd::Constant(n_, enough ? kLeastInflation : 1.0);
  std::vector<Eigen::VectorXd> steps;  // each block's pull on the estimate
  for (size_t k = 1; k < blocks_.size(); ++k) {
    const Block& b = blocks_[k];
    steps.push_back(covariance * (b.score + b.information * (eta - b.eta)));
  }
  // Coarser and coarser groups see longer and longer correlation; the largest variance counts.
  for (size_t group = 1; steps.size() / group >= kMinGroups; group *= 2) {
    const size_t groups = steps.size() / group;
    Eigen::VectorXd sum_of_squares = Eigen::VectorXd::Zero(n_);
    for (size_t g = 0; g < groups; ++g) {
      Eigen::VectorXd sum = Eigen::VectorXd::Zero(n_);
      for (size_t k = g * group; k < (g + 1) * group; ++k) sum += steps[k];
      sum_of_squares += sum.cwiseAbs2();
    }
    const double m = static_cast<double>(groups);
    for (int i = 0; i < n_; ++i) {
      const double ratio = sum_of_squares[i] / std::max(1e-300, covariance(i, i));
      const double variance = (m * ratio + kPriorGroups) / (m + kPriorGroups);
      inflation[i] = std::max(inflation[i], std::sqrt(variance));
    }
  }
  return inflation;
}

}  // namespace odmc
