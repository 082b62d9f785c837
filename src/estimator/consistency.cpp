#include "odmc/estimator/consistency.h"

#include <algorithm>
#include <cmath>

namespace odmc {
namespace {

constexpr int kMaxBlocks = 128;  // even
constexpr double kLeastInflation = 0.5;
constexpr int kMinGroups = 8;  // fewer block sums than this say nothing about a variance
constexpr int kMinBlocksForThirds = 6;
constexpr double kPriorGroups = 8.0;  // weight of "white" against a small sample of block sums

}  // namespace

Consistency::Consistency(int num_parameters)
    : n_(num_parameters),
      score_(Eigen::VectorXd::Zero(n_)),
      eta_sum_(score_),
      left_(Eigen::MatrixXd::Zero(n_, n_)),
      blocks_(kMaxBlocks, Block{score_, score_, left_}),
      pending_root_(left_),
      pending_scale_(left_),
      scale_(left_),
      half_(left_),
      steps_(Eigen::MatrixXd::Zero(n_, kMaxBlocks)),
      scaled_(score_),
      sum_(score_),
      shift_(score_),
      sum_of_squares_(score_),
      white_(score_),
      flown_(score_),
      inflation_(score_) {}

void Consistency::SetWalking(const std::vector<int>& entries) { walking_ = entries; }

template <typename Difference>
void Consistency::Shift(const Difference& difference, Eigen::VectorXd* shift) const {
  *shift = difference;
  for (const int i : walking_) (*shift)[i] = 0.0;
}

void Consistency::Add(double dt, const Eigen::Ref<const Eigen::VectorXd>& score,
                      const Eigen::Ref<const Eigen::VectorXd>& eta) {
  score_ += score;
  eta_sum_ += dt * eta;
  block_s_ += dt;
}

void Consistency::CloseBlock(const Eigen::MatrixXd& left) {
  ApplyRescaling();
  // The first block's share of the information includes the prior; its score at the prior's centre
  // is zero there, and elsewhere the linear correction below accounts for it.
  Block& block = blocks_[static_cast<size_t>(num_blocks_++)];
  block.score = score_;
  block.eta = eta_sum_ / block_s_;
  block.information = left - left_;
  block.length_s = block_s_;
  left_ = left;
  score_.setZero();
  eta_sum_.setZero();
  block_s_ = 0.0;
  if (num_blocks_ == kMaxBlocks) Merge();
}

void Consistency::Walked(const Eigen::MatrixXd& before, const Eigen::MatrixXd& after) {
  left_ -= before;
  left_ += after;
}

/// Makes one block of every two.
void Consistency::Merge() {
  for (size_t i = 0; 2 * i < kMaxBlocks; ++i) {
    const Block &a = blocks_[2 * i], &b = blocks_[2 * i + 1];
    Block& merged = blocks_[i];
    const double length = a.length_s + b.length_s;
    // Scores of both halves at one common estimate.
    sum_ = (a.length_s * a.eta + b.length_s * b.eta) / length;
    scaled_ = a.score + b.score;
    Shift(sum_ - a.eta, &shift_);
    scaled_.noalias() += a.information * shift_;
    Shift(sum_ - b.eta, &shift_);
    scaled_.noalias() += b.information * shift_;
    merged.information = a.information + b.information;
    merged.score = scaled_;
    merged.eta = sum_;
    merged.length_s = length;
  }
  num_blocks_ /= 2;
  block_length_s_ *= 2.0;
}

void Consistency::Rescale(const Eigen::MatrixXd& root) {
  scale_.noalias() = root * root;
  scaled_.noalias() = scale_ * score_;
  score_.swap(scaled_);
  half_.noalias() = root * left_;
  left_.noalias() = half_ * root;
  // There may be a hundred blocks, and only their next use needs them.
  if (num_blocks_ == 0) return;
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
  for (int i = 0; i < num_blocks_; ++i) {
    Block& block = blocks_[static_cast<size_t>(i)];
    scaled_.noalias() = pending_scale_ * block.score;
    block.score.swap(scaled_);
    half_.noalias() = pending_root_ * block.information;
    block.information.noalias() = half_ * pending_root_.transpose();
  }
}

const Eigen::VectorXd& Consistency::Inflation(const Eigen::Ref<const Eigen::VectorXd>& eta,
                                              const Eigen::MatrixXd& covariance,
                                              const Eigen::VectorXd& prior_sigma) {
  ApplyRescaling();
  // Of the variance C = C (F + P) C, with F the flight's information and P the priors', the share
  // that the flight's noise makes.
  for (int i = 0; i < n_; ++i) {
    const double priors = covariance.col(i).cwiseQuotient(prior_sigma).squaredNorm();
    flown_[i] = std::max(0.0, 1.0 - priors / std::max(1e-300, covariance(i, i)));
  }
  for (const int i : walking_) flown_[i] = 1.0;
  // Until there are enough blocks to judge by, the white value; then whatever they show.
  inflation_.setConstant(n_, num_blocks_ > kMinGroups ? kLeastInflation * kLeastInflation : 1.0);
  inflation_.array() *= flown_.array();
  // Each block's pull on the estimate.
  const int num_steps = std::max(num_blocks_ - 1, 0);
  for (int k = 0; k < num_steps; ++k) {
    const Block& b = blocks_[static_cast<size_t>(k + 1)];
    Shift(eta - b.eta, &shift_);
    scaled_ = b.score;
    scaled_.noalias() += b.information * shift_;
    steps_.col(k).noalias() = covariance * scaled_;
    // Of what walks, the present covariance is about the present: the scores by their own size.
    for (const int i : walking_) steps_(i, k) = b.score[i];
  }
  // Coarser and coarser groups see longer and longer correlation; the largest variance counts.
  for (int group = 1; num_steps / group >= kMinGroups; group *= 2) {
    const int groups = num_steps / group;
    sum_of_squares_.setZero();
    for (int g = 0; g < groups; ++g) {
      sum_.setZero();
      for (int k = g * group; k < (g + 1) * group; ++k) sum_ += steps_.col(k);
      sum_of_squares_ += sum_.cwiseAbs2();
    }
    const double m = groups;
    white_ = covariance.diagonal();
    for (const int i : walking_) {
      white_[i] = 0.0;
      for (int k = 0; k < groups * group; ++k) {
        white_[i] += std::max(0.0, blocks_[static_cast<size_t>(k + 1)].information(i, i));
      }
    }
    for (int i = 0; i < n_; ++i) {
      const double ratio = sum_of_squares_[i] / std::max(1e-300, white_[i]);
      const double variance = (m * ratio + kPriorGroups * flown_[i]) / (m + kPriorGroups);
      inflation_[i] = std::max(inflation_[i], variance);
    }
  }
  inflation_ = (Eigen::VectorXd::Ones(n_) - flown_ + inflation_).cwiseSqrt();
  return inflation_;
}

std::vector<ThirdOfFlight> Consistency::Thirds(const Eigen::Ref<const Eigen::VectorXd>& eta,
                                               const Eigen::VectorXd& prior_sigma) {
  // The first block holds the priors, too.
  if (num_blocks_ < kMinBlocksForThirds + 1) return {};
  ApplyRescaling();
  double total_s = 0.0;
  for (int i = 1; i < num_blocks_; ++i) total_s += blocks_[static_cast<size_t>(i)].length_s;
  std::vector<ThirdOfFlight> thirds;
  double passed_s = 0.0;
  int next = 1;
  for (int t = 1; t <= 3; ++t) {
    ThirdOfFlight third;
    Eigen::MatrixXd information = Eigen::MatrixXd::Zero(n_, n_);
    Eigen::VectorXd gradient = Eigen::VectorXd::Zero(n_);
    for (; next < num_blocks_ && (t == 3 || passed_s < t * total_s / 3.0 - 1e-9); ++next) {
      const Block& block = blocks_[static_cast<size_t>(next)];
      information += block.information;
      Shift(eta - block.eta, &shift_);
      gradient += block.score + block.information * shift_;
      passed_s += block.length_s;
      third.length_s += block.length_s;
    }
    const Eigen::VectorXd known = information.diagonal();
    const Eigen::VectorXd with_prior = known + prior_sigma.cwiseAbs2().cwiseInverse();
    third.step = -gradient.cwiseQuotient(with_prior);
    third.variance = known.cwiseQuotient(with_prior.cwiseAbs2()).cwiseMax(0.0);
    if (!third.step.allFinite() || !third.variance.allFinite()) return {};
    thirds.push_back(std::move(third));
  }
  return thirds;
}

}  // namespace odmc
