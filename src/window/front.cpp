#include "odmc/window/front.h"

#include <Eigen/Cholesky>
#include <array>

namespace odmc {

FrontColumns::FrontColumns(const Window& window, std::int64_t keyframe)
    : id(keyframe), bias(window.keyframe(keyframe).bias) {
  const bool has_next = keyframe < window.keyframes().back().id;
  const std::int64_t next_bias = has_next ? window.keyframe(keyframe + 1).bias : -1;
  int column = kStateTangentSize;
  if (bias >= 0 && bias != next_bias) {
    leaving_bias = column;
    column += 6;
  }
  num_eliminated = column;
  if (has_next) {
    next_state = column;
    column += kStateTangentSize;
  }
  if (next_bias >= 0) {
    kept_bias = column;
    column += 6;
  }
  parameters = column;
  total = column + window.layout().num_estimated();
}

void AddToFront(const Factor& factor, const LinearFactor& linear, const FrontColumns& columns,
                Eigen::MatrixXd* front) {
  struct Span {
    int from, to, size;
  };
  std::array<Span, 5> spans;
  int count = 0;
  const auto add = [&](int from, int to, int size) {
    if (from >= 0) spans[count++] = {from, to, size};
  };
  add(linear.state0, columns.StateColumn(factor.state0), kStateTangentSize);
  add(linear.state1, columns.StateColumn(factor.state1), kStateTangentSize);
  add(linear.bias0, columns.BiasColumn(factor.bias0), 6);
  add(linear.bias1, columns.BiasColumn(factor.bias1), 6);
  add(linear.parameters, columns.parameters, columns.total - columns.parameters);
  for (int a = 0; a < count; ++a) {
    const auto Ja = linear.J.middleCols(spans[a].from, spans[a].size);
    for (int b = 0; b < count; ++b) {
      if (spans[b].to < spans[a].to) continue;
      front->block(spans[a].to, spans[b].to, spans[a].size, spans[b].size).noalias() +=
          Ja.transpose() * linear.J.middleCols(spans[b].from, spans[b].size);
    }
    front->block(spans[a].to, columns.total, spans[a].size, 1).noalias() +=
        Ja.transpose() * linear.r;
  }
  (*front)(columns.total, columns.total) += linear.r.squaredNorm();
}

void AddToFront(const Eigen::MatrixXd& message, const FrontColumns& columns,
                Eigen::MatrixXd* front) {
  // The state, the bias where it lies in this front, parameters with the gradient behind.
  const int rest = columns.total - columns.parameters + 1;
  const int bias = columns.bias >= 0 ? columns.BiasColumn(columns.bias) : -1;
  const auto add = [&](int from_row, int to_row, int rows, int from_col, int to_col, int cols) {
    front->block(to_row, to_col, rows, cols) += message.block(from_row, from_col, rows, cols);
  };
  const int state = kStateTangentSize;
  const int behind = state + (bias >= 0 ? 6 : 0);
  add(0, 0, state, 0, 0, state);
  add(0, 0, state, behind, columns.parameters, rest);
  add(behind, columns.parameters, rest, behind, columns.parameters, rest);
  if (bias < 0) return;
  add(0, 0, state, state, bias, 6);
  add(state, bias, 6, state, bias, 6);
  add(state, bias, 6, behind, columns.parameters, rest);
}

Eigen::MatrixXd PriorMessage(const Window& window) {
  const Prior& prior = window.prior();
  const int n = window.layout().num_estimated();
  const bool with_bias = !window.keyframes().empty() && window.keyframes().front().bias >= 0;
  const int size = kStateTangentSize + (with_bias ? 6 : 0) + n + 1;
  Eigen::MatrixXd message = Eigen::MatrixXd::Zero(size, size);
  if (prior.b.size() == 0) return message;
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(prior.b.size(), size);
  if (prior.has_state) A.leftCols<kStateTangentSize>() = PriorStateJacobian(window);
  if (prior.has_bias) {
    A.middleCols<6>(kStateTangentSize) = prior.A.middleCols<6>(prior.state_columns());
  }
  A.middleCols(size - 1 - n, n) = prior.A.rightCols(n);
  A.col(size - 1) = PriorResidual(window);
  message.selfadjointView<Eigen::Upper>().rankUpdate(A.transpose());
  return message;
}

bool EliminateFront(const Eigen::MatrixXd& front, const FrontColumns& columns,
                    EliminatedFront* eliminated, Eigen::MatrixXd* message) {
  const int e = columns.num_eliminated;
  const int rest = columns.total + 1 - e;
  const Eigen::LLT<Eigen::MatrixXd, Eigen::Upper> llt(front.topLeftCorner(e, e));
  if (llt.info() != Eigen::Success) return false;
  eliminated->U = llt.matrixU();
  eliminated->W = front.topRightCorner(e, rest);
  llt.matrixL().solveInPlace(eliminated->W);
  *message = front.bottomRightCorner(rest, rest);
  message->selfadjointView<Eigen::Upper>().rankUpdate(eliminated->W.transpose(), -1.0);
  return true;
}

}  // namespace odmc
