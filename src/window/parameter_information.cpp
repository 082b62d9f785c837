#include "odmc/window/parameter_information.h"

#include <algorithm>
#include <utility>

#include "odmc/window/marginalization.h"

namespace odmc {
namespace {

/// The window's prior as rows over its oldest state, that one's bias and the parameters, at the
/// present estimate.
Eigen::MatrixXd PriorRows(const Window& window) {
  const Prior& prior = window.prior();
  const int n = window.layout().num_estimated();
  const bool with_bias = !window.keyframes().empty() && window.keyframes().front().bias >= 0;
  const int others = kStateTangentSize + (with_bias ? 6 : 0);
  Eigen::MatrixXd rows = Eigen::MatrixXd::Zero(prior.b.size(), others + n);
  if (prior.has_state) rows.leftCols<kStateTangentSize>() = PriorStateJacobian(window);
  if (prior.has_bias) {
    rows.middleCols<6>(kStateTangentSize) = prior.A.middleCols<6>(prior.state_columns());
  }
  rows.rightCols(n) = prior.A.rightCols(n);
  return rows;
}

/// A keyframe's front: what all before it say, and its factors. What cannot be evaluated says
/// nothing.
Eigen::MatrixXd FrontRows(const Window& window, const FrontColumns& columns,
                          const Eigen::MatrixXd& message) {
  const std::vector<Factor>& factors = window.keyframe(columns.id).factors;
  const int n = window.layout().num_estimated();
  auto row = static_cast<int>(message.rows());
  int rows = row;
  for (const Factor& factor : factors) rows += factor.cost->num_residuals();
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(rows, columns.total);
  A.topLeftCorner(row, kStateTangentSize) = message.leftCols<kStateTangentSize>();
  if (columns.bias >= 0) {
    A.block(0, columns.BiasColumn(columns.bias), row, 6) = message.middleCols<6>(kStateTangentSize);
  }
  A.topRightCorner(row, n) = message.rightCols(n);
  LinearFactor linear;
  for (const Factor& factor : factors) {
    if (!Linearize(window, factor, false, &linear)) continue;
    PlaceRows(factor, linear, columns, row, &A);
    row += static_cast<int>(linear.r.size());
  }
  return A;
}

/// Columns of variables of the next keyframe only, for the message to it.
Eigen::MatrixXd MessageOf(const Eigen::MatrixXd& front, const FrontColumns& columns) {
  return Eliminate({front, Eigen::VectorXd::Zero(front.rows()), columns.num_eliminated}).A;
}

}  // namespace

bool ParameterInformation::Reusable(const Window& window,
                                    const Eigen::VectorXd& relinearize) const {
  if (eta_.size() != relinearize.size()) return false;
  return ((window.eta() - eta_).array().abs() <= relinearize.array()).all();
}

void ParameterInformation::Rescale(const Eigen::MatrixXd& root) {
  const auto n = root.cols();
  for (Message& message : messages_) {
    message.rows.rightCols(n) = (message.rows.rightCols(n) * root).eval();
  }
}

const Eigen::MatrixXd& ParameterInformation::Update(const Window& window,
                                                    const Eigen::VectorXd& relinearize) {
  const auto& keyframes = window.keyframes();
  const int n = window.layout().num_estimated();
  if (!Reusable(window, relinearize)) {
    messages_.clear();
    eta_ = window.eta();
  }

  // Where to start: the newest kept message that is old enough, else the prior.
  std::int64_t start = keyframes.empty() ? 0 : keyframes.front().id;
  const std::int64_t newest = keyframes.empty() ? -1 : keyframes.back().id;
  messages_.erase(
      std::remove_if(messages_.begin(), messages_.end(),
                     [&](const Message& m) { return m.id < start || m.id > newest - fresh_; }),
      messages_.end());
  Eigen::MatrixXd message;
  if (!messages_.empty()) {
    start = messages_.back().id;
    message = std::move(messages_.back().rows);
    messages_.pop_back();
  } else {
    message = PriorRows(window);
  }

  const Eigen::VectorXd of_priors = window.parameter_sigma().cwiseAbs2().cwiseInverse();
  newest_.resize(0, 0);
  for (std::int64_t id = start; id <= newest; ++id) {
    const FrontColumns columns(window, id);
    const Eigen::MatrixXd front = FrontRows(window, columns, message);
    messages_.push_back({id, std::move(message)});
    if (id == newest) {
      newest_.noalias() = front.transpose() * front;
      newest_.diagonal().tail(n) += of_priors;
    }
    message = MessageOf(front, columns);
  }
  information_.noalias() = message.rightCols(n).transpose() * message.rightCols(n);
  information_.diagonal() += of_priors;
  return information_;
}

}  // namespace odmc
