#include "odmc/window/parameter_information.h"

#include <Eigen/Cholesky>
#include <algorithm>

namespace odmc {
namespace {

constexpr int kState = kStateTangentSize;

/// Marginal of the trailing columns of a symmetric positive matrix, the first `e` eliminated. A
/// tiny ridge keeps directions that nobody measured from failing; they carry no information either
/// way.
Eigen::MatrixXd Marginal(const Eigen::MatrixXd& H, int e) {
  const int n = static_cast<int>(H.cols()) - e;
  Eigen::MatrixXd head = H.topLeftCorner(e, e);
  head.diagonal().array() += 1e-12 * head.diagonal().maxCoeff() + 1e-300;
  const Eigen::LLT<Eigen::MatrixXd> llt(head);
  const Eigen::MatrixXd W = llt.matrixL().solve(H.topRightCorner(e, n));
  Eigen::MatrixXd result = H.bottomRightCorner(n, n);
  result.noalias() -= W.transpose() * W;
  return result;
}

}  // namespace

int ParameterInformation::BorderColumn(std::int64_t bias) const {
  return static_cast<int>(bias - first_bias_) * 6;
}

bool ParameterInformation::Reusable(const Window& window,
                                    const Eigen::VectorXd& relinearize) const {
  const std::int64_t first = window.biases().empty() ? -1 : window.biases().front().id;
  if (first != first_bias_ || static_cast<int>(window.biases().size()) != num_biases_) return false;
  if (eta_.size() != relinearize.size()) return false;
  return ((window.eta() - eta_).array().abs() <= relinearize.array()).all();
}

void ParameterInformation::Rescale(const Eigen::MatrixXd& root) {
  for (Message& message : messages_) {
    message.H.rightCols(root.cols()) *= root;
    message.H.bottomRows(root.cols()) = (root * message.H.bottomRows(root.cols())).eval();
  }
}

const Eigen::MatrixXd& ParameterInformation::Update(const Window& window,
                                                    const Eigen::VectorXd& relinearize) {
  const auto& keyframes = window.keyframes();
  const int n = window.layout().num_estimated();
  if (!Reusable(window, relinearize)) {
    messages_.clear();
    first_bias_ = window.biases().empty() ? -1 : window.biases().front().id;
    num_biases_ = static_cast<int>(window.biases().size());
    eta_ = window.eta();
  }
  const int border = 6 * num_biases_ + n;
  const Prior& prior = window.prior();
  Eigen::MatrixXd H = Eigen::MatrixXd::Zero(kState + border, kState + border);

  // Where to start: the newest kept message that is old enough, else the prior.
  std::int64_t start = keyframes.empty() ? 0 : keyframes.front().id;
  const std::int64_t newest = keyframes.empty() ? -1 : keyframes.back().id;
  messages_.erase(
      std::remove_if(messages_.begin(), messages_.end(),
                     [&](const Message& m) { return m.id < start || m.id > newest - fresh_; }),
      messages_.end());
  if (!messages_.empty()) {
    start = messages_.back().id;
    H = messages_.back().H;
    messages_.pop_back();
  } else {
    // Columns of the prior in [state, border].
    Eigen::MatrixXd A = Eigen::MatrixXd::Zero(prior.b.size(), kState + border);
    if (prior.has_state) A.leftCols<kState>() = prior.A.leftCols<kState>();
    if (prior.has_bias) {
      A.middleCols<6>(kState + BorderColumn(keyframes.front().bias)) =
          prior.A.middleCols<6>(prior.state_columns());
    }
    A.rightCols(n) = prior.A.rightCols(n);
    H.noalias() = A.transpose() * A;
  }

  LinearFactor linear;
  for (std::int64_t id = start; id <= newest; ++id) {
    messages_.push_back({id, H});
    // [this state, next state, border]
    Eigen::MatrixXd front = Eigen::MatrixXd::Zero(2 * kState + border, 2 * kState + border);
    front.topLeftCorner<kState, kState>() = H.topLeftCorner<kState, kState>();
    front.topRightCorner(kState, border) = H.topRightCorner(kState, border);
    front.bottomLeftCorner(border, kState) = H.bottomLeftCorner(border, kState);
    front.bottomRightCorner(border, border) = H.bottomRightCorner(border, border);
    for (const Factor& factor : window.keyframe(id).factors) {
      if (!Linearize(window, factor, false, &linear)) continue;
      struct Span {
        int from, to, size;
      };
      std::vector<Span> spans;
      if (linear.state0 >= 0) spans.push_back({linear.state0, 0, kState});
      if (linear.state1 >= 0) spans.push_back({linear.state1, kState, kState});
      if (linear.bias0 >= 0) {
        spans.push_back({linear.bias0, 2 * kState + BorderColumn(factor.bias0), 6});
      }
      if (linear.bias1 >= 0) {
        spans.push_back({linear.bias1, 2 * kState + BorderColumn(factor.bias1), 6});
      }
      if (linear.parameters >= 0) {
        spans.push_back({linear.parameters, 2 * kState + 6 * num_biases_, n});
      }
      const Eigen::MatrixXd JtJ = linear.J.transpose() * linear.J;
      for (const Span& a : spans) {
        for (const Span& b : spans) {
          front.block(a.to, b.to, a.size, b.size) += JtJ.block(a.from, b.from, a.size, b.size);
        }
      }
    }
    H = Marginal(front, kState);
  }
  // The last H has an empty next state in front; then the biases go.
  Eigen::MatrixXd rest = H.bottomRightCorner(border, border);
  information_ = num_biases_ > 0 ? Marginal(rest, 6 * num_biases_) : rest;
  information_ = 0.5 * (information_ + information_.transpose()).eval();
  information_.diagonal() += window.parameter_sigma().cwiseAbs2().cwiseInverse();
  return information_;
}

}  // namespace odmc
