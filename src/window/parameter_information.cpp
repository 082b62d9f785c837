#include "odmc/window/parameter_information.h"

#include <algorithm>

#include "odmc/window/front.h"

namespace odmc {
namespace {

/// Eliminates a front. A ridge keeps directions of the eliminated variables that nobody measured
/// from failing; they carry no information either way. What can't be eliminated at all (a factor
/// that is not a number) says nothing.
Eigen::MatrixXd Eliminated(const FrontColumns& columns, Eigen::MatrixXd* front) {
  EliminatedFront eliminated;
  const int rest = columns.total + 1 - columns.num_eliminated;
  Eigen::MatrixXd message = Eigen::MatrixXd::Zero(rest, rest);
  auto diagonal = front->diagonal().head(columns.num_eliminated);
  const double largest = diagonal.maxCoeff();
  for (double ridge = 1e-12; ridge <= 1.0; ridge *= 100.0) {
    diagonal.array() += ridge * largest + 1e-300;
    if (EliminateFront(*front, columns, &eliminated, &message)) break;
  }
  return message;
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
    Eigen::MatrixXd H = message.normal.selfadjointView<Eigen::Upper>();
    const auto first = H.cols() - 1 - n;
    H.middleCols(first, n) *= root;
    H.middleRows(first, n) = (root * H.middleRows(first, n)).eval();
    message.normal = H.triangularView<Eigen::Upper>();
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
    message = std::move(messages_.back().normal);
    messages_.pop_back();
  } else {
    message = PriorMessage(window);
  }

  LinearFactor linear;
  Eigen::MatrixXd front;
  newest_.resize(0, 0);
  for (std::int64_t id = start; id <= newest; ++id) {
    const FrontColumns columns(window, id);
    front.setZero(columns.total + 1, columns.total + 1);
    AddToFront(message, columns, &front);
    for (const Factor& factor : window.keyframe(id).factors) {
      if (Linearize(window, factor, false, &linear)) {
        AddToFront(factor, linear, columns, &front);
      }
    }
    messages_.push_back({id, std::move(message)});
    if (id == newest) {
      newest_ = front.topLeftCorner(columns.total, columns.total).selfadjointView<Eigen::Upper>();
      newest_.diagonal().tail(n) += window.parameter_sigma().cwiseAbs2().cwiseInverse();
    }
    message = Eliminated(columns, &front);
  }
  const auto of_parameters = message.bottomRightCorner(n + 1, n + 1).topLeftCorner(n, n);
  information_ = of_parameters.selfadjointView<Eigen::Upper>();
  information_.diagonal() += window.parameter_sigma().cwiseAbs2().cwiseInverse();
  return information_;
}

}  // namespace odmc
