#include "odmc/window/chain_prior.h"

#include "odmc/window/householder.h"

namespace odmc {
namespace {

constexpr int kState = kStateTangentSize;

}  // namespace

void ReadChain(const Window& window, Chain* chain, ChainPast* past) {
  chain->Clear();
  for (const Keyframe& keyframe : window.keyframes()) {
    chain->fronts.Append().Reset(window, keyframe.id);
  }
  ChainFront* const oldest = chain->fronts.empty() ? nullptr : &chain->fronts.front();
  ReadChainPrior(window, oldest, past);
  if (window.prior().has_state) {
    oldest->point = window.keyframes().front().x_lin;
    oldest->delta_version = -1;  // the state is elsewhere
  }
}

void ReadChainPrior(const Window& window, ChainFront* oldest, ChainPast* past) {
  const int n = window.layout().num_estimated();
  past->Clear(n);
  const Prior& prior = window.prior();
  const BorderColumns border(n);
  const int rows = static_cast<int>(prior.b.size());
  RowBlock block;
  block.SetZero(rows, PaddedRow(kState + border.size()));
  Eigen::VectorXd b = prior.b - prior.A.rightCols(n) * prior.eta_lin;
  if (prior.has_bias) {
    const Bias& bias = window.bias(window.keyframes().front().bias);
    b -= prior.A.middleCols<6>(prior.state_columns()) *
         Eigen::Map<const Eigen::Matrix<double, 6, 1>>(bias.x_lin.data());
  }
  for (int i = 0; i < rows; ++i) {
    double* row = block.row(i);
    const auto put = [&](int from, int count, int to) {
      for (int j = 0; j < count; ++j) row[to + j] = prior.A(i, from + j);
    };
    put(0, prior.state_columns(), 0);
    put(prior.state_columns(), prior.bias_columns(), kState);
    put(prior.state_columns() + prior.bias_columns(), n, kState + BorderColumns::kParameters);
    row[kState + border.rhs()] = b[i];
  }
  int taken = 0;
  if (oldest != nullptr) {
    RowBlock& message = oldest->message;
    taken = Triangularise(block.data.data(), block.stride, rows, kState, kState + border.size(),
                          message.data.data(), message.stride);
  }
  if (taken == rows) return;  // of no rows there is no address
  past->Absorb(block.data.data() + taken * block.stride + kState, block.stride, rows - taken);
}

void WriteChainPrior(const RootTriangle& past, const ChainFront* oldest, Window* window) {
  const int n = window->layout().num_estimated();
  Prior& prior = window->prior();
  prior = Prior();
  prior.eta_lin = window->eta();
  const bool any = oldest != nullptr;
  const std::int64_t bias = any ? window->keyframes().front().bias : -1;
  prior.has_state = any;
  prior.has_bias = bias >= 0;
  const int first_bias = prior.state_columns(), first = first_bias + prior.bias_columns();
  const int size = (any ? kState : 0) + prior.bias_columns() + n;
  prior.A.setZero(size, first + n);
  prior.b.setZero(size);
  int row = 0;
  // Parameters and biases count from zero here, from their present values in the prior.
  const auto put_border = [&](const double* border) {
    for (int j = 0; j < prior.bias_columns(); ++j) prior.A(row, first_bias + j) = border[j];
    for (int j = 0; j < n; ++j) prior.A(row, first + j) = border[BorderColumns::kParameters + j];
    prior.b[row] = border[past.columns().rhs()] + prior.A.row(row).tail(n).dot(prior.eta_lin) +
                   border[past.columns().anchor()] * window->anchor();
    for (int j = 0; j < prior.bias_columns(); ++j) {
      prior.b[row] += border[j] * window->bias(bias).x[static_cast<size_t>(j)];
    }
    ++row;
  };
  if (any) {
    for (int i = 0; i < kState; ++i) {
      for (int j = i; j < kState; ++j) prior.A(row, j) = oldest->message.row(i)[j];
      put_border(oldest->message.row(i) + kState);
    }
    Keyframe& keyframe = window->keyframes().front();
    keyframe.in_prior = true;
    keyframe.x_lin = oldest->point;
  }
  if (prior.has_bias) {
    Bias& in_prior = window->bias(bias);
    in_prior.in_prior = true;
    in_prior.x_lin = in_prior.x;
    for (int i = 0; i < 6; ++i) put_border(past.row(i));
  }
  for (int i = 0; i < n; ++i) put_border(past.row(BorderColumns::kParameters + i));
}

}  // namespace odmc
