#include "odmc/window/window.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <utility>

#include "odmc/math/so3.h"

namespace odmc {
namespace {

/// A prior's columns of the state where its rotation has left the linearization point by `theta`:
/// through the inverse right Jacobian.
Eigen::MatrixXd StateColumnsAt(const Eigen::MatrixXd& A, const Eigen::Vector3d& theta) {
  Eigen::MatrixXd columns = A.leftCols<kStateTangentSize>();
  columns.middleCols<3>(kTangentRotation) *= RightJacobianInverse(theta);
  return columns;
}

}  // namespace

Window::Window(const ParameterLayout* layout) : layout_(layout), eta_(layout->num_estimated()) {
  const int n = layout->num_estimated();
  parameter_centre_.resize(n);
  parameter_sigma_.resize(n);
  for (int i = 0; i < n; ++i) {
    parameter_centre_[i] = layout->PriorCentre(i);
    parameter_sigma_[i] = layout->PriorSigma(i);
  }
  eta_ = parameter_centre_;
  prior_.A.resize(0, n);
  prior_.b.resize(0);
  prior_.eta_lin = eta_;
}

std::int64_t Window::AddKeyframe(Stamp stamp, const State& initial, bool linked,
                                 std::int64_t bias) {
  Keyframe& keyframe = keyframes_.Append();
  keyframe.id = next_keyframe_++;
  keyframe.stamp = stamp;
  keyframe.bias = bias;
  keyframe.linked = linked;
  keyframe.in_prior = false;
  initial.ToBlock(keyframe.x.data());
  keyframe.x_lin = keyframe.x;
  keyframe.factors.clear();
  return keyframe.id;
}

std::int64_t Window::AddBias(const Eigen::Matrix<double, 6, 1>& initial) {
  Bias& bias = biases_.Append();
  bias.id = next_bias_++;
  bias.in_prior = false;
  std::copy(initial.data(), initial.data() + 6, bias.x.begin());
  bias.x_lin = bias.x;
  return bias.id;
}

void Window::AddFactor(Factor factor) {
  const std::int64_t owner = factor.state0 >= 0 ? factor.state0 : keyframes_.back().id;
  keyframe(owner).factors.push_back(std::move(factor));
}

void Window::Touch(Factor* factor) {
  ++factor->revision;
  const std::int64_t owner = factor->state0 >= 0 ? factor->state0 : keyframes_.front().id;
  if (touched_ < 0 || owner < touched_) touched_ = owner;
}

std::int64_t Window::TakeTouched() { return std::exchange(touched_, -1); }

void Window::DropNewestKeyframes(std::int64_t id) {
  while (keyframes_.back().id >= id) {
    for (Factor& factor : keyframes_.back().factors) {
      spares_[static_cast<size_t>(factor.kind)].push_back(std::move(factor.cost));
    }
    keyframes_.back().factors.clear();
    keyframes_.pop_back();
  }
  next_keyframe_ = id;
  const std::int64_t last_bias = keyframes_.back().bias;
  while (!biases_.empty() && biases_.back().id > last_bias) biases_.pop_back();
  next_bias_ = biases_.empty() ? next_bias_ : biases_.back().id + 1;
  auto& factors = keyframes_.back().factors;
  for (size_t i = factors.size(); i-- > 0;) {
    const Factor& factor = factors[i];
    if (factor.state1 < id && factor.bias0 <= last_bias && factor.bias1 <= last_bias) continue;
    spares_[static_cast<size_t>(factor.kind)].push_back(std::move(factors[i].cost));
    factors.erase(factors.begin() + static_cast<std::ptrdiff_t>(i));
  }
  touched_ = touched_ >= id ? -1 : touched_;
}

void Window::DropOldestKeyframe() {
  for (Factor& factor : keyframes_.front().factors) {
    spares_[static_cast<size_t>(factor.kind)].push_back(std::move(factor.cost));
  }
  keyframes_.front().factors.clear();
  keyframes_.pop_front();
}

std::unique_ptr<ceres::CostFunction> Window::TakeSpare(FactorKind kind) {
  auto& spares = spares_[static_cast<size_t>(kind)];
  if (spares.empty()) return nullptr;
  std::unique_ptr<ceres::CostFunction> spare = std::move(spares.back());
  spares.pop_back();
  return spare;
}

FactorBlocks Window::Blocks(const Factor& factor, bool at_linearization) const {
  FactorBlocks blocks;
  const auto add = [&blocks](const double* block) { blocks.pointers[blocks.count++] = block; };
  for (const std::int64_t id : {factor.state0, factor.state1}) {
    if (id < 0) continue;
    const Keyframe& k = keyframe(id);
    add(at_linearization && k.in_prior ? k.x_lin.data() : k.x.data());
  }
  for (const std::int64_t id : {factor.bias0, factor.bias1}) {
    if (id < 0) continue;
    const Bias& b = bias(id);
    add(at_linearization && b.in_prior ? b.x_lin.data() : b.x.data());
  }
  if (factor.parameters && eta_.size() > 0) {
    add(at_linearization ? prior_.eta_lin.data() : eta_.data());
  }
  if (factor.anchored) add(&anchor_);
  return blocks;
}

std::vector<double*> Window::MutableBlocks(const Factor& factor) {
  std::vector<double*> blocks;
  const FactorBlocks of_factor = Blocks(factor, false);
  for (int i = 0; i < of_factor.count; ++i) {
    blocks.push_back(const_cast<double*>(of_factor.pointers[i]));
  }
  return blocks;
}

std::vector<double*> Window::PriorBlocks() {
  std::vector<double*> blocks;
  if (prior_.has_state) blocks.push_back(keyframes_.front().x.data());
  if (prior_.has_bias) blocks.push_back(bias(keyframes_.front().bias).x.data());
  if (eta_.size() > 0) blocks.push_back(eta_.data());
  return blocks;
}

namespace {

/// Residual of a cost at `points` and its ambient Jacobians, row-major in a buffer of the thread.
/// @returns false if it cannot be evaluated
bool EvaluateWithJacobians(const ceres::CostFunction& cost, const FactorBlocks& points,
                           Eigen::VectorXd* r, std::array<double*, 6>* jacobians) {
  const int rows = cost.num_residuals();
  const auto& sizes = cost.parameter_block_sizes();
  size_t total = 0;
  for (const int size : sizes) total += static_cast<size_t>(rows) * size;
  thread_local std::vector<double> buffer;
  if (buffer.size() < total) buffer.resize(total);
  double* next = buffer.data();
  for (size_t i = 0; i < sizes.size(); ++i) {
    (*jacobians)[i] = next;
    next += static_cast<size_t>(rows) * sizes[i];
  }
  r->resize(rows);
  return cost.Evaluate(points.data(), r->data(), jacobians->data());
}

/// Names the columns of the factor's variables. @returns their number
int PlaceColumns(const Factor& factor, int num_parameters, LinearFactor* linear) {
  int columns = 0;
  const auto take = [&columns](bool present, int size) {
    const int first = present ? columns : -1;
    if (present) columns += size;
    return first;
  };
  linear->state0 = take(factor.state0 >= 0, kStateTangentSize);
  linear->state1 = take(factor.state1 >= 0, kStateTangentSize);
  linear->bias0 = take(factor.bias0 >= 0, 6);
  linear->bias1 = take(factor.bias1 >= 0, 6);
  linear->parameters = take(factor.parameters && num_parameters > 0, num_parameters);
  return columns;
}

/// Writes the minimal Jacobian. The anchor, an anchored factor's last block, is constant.
void WriteMinimal(const Factor& factor, const FactorBlocks& points,
                  const std::array<double*, 6>& jacobians, Eigen::MatrixXd* J) {
  using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  const auto& sizes = factor.cost->parameter_block_sizes();
  const int num_states = (factor.state0 >= 0 ? 1 : 0) + (factor.state1 >= 0 ? 1 : 0);
  const size_t num_blocks = sizes.size() - (factor.anchored ? 1 : 0);
  int column = 0;
  for (size_t i = 0; i < num_blocks; ++i) {
    const Eigen::Map<const RowMajor> ambient(jacobians[i], J->rows(), sizes[i]);
    if (static_cast<int>(i) >= num_states) {
      J->middleCols(column, sizes[i]) = ambient;
      column += sizes[i];
      continue;
    }
    Eigen::Matrix<double, 13, 12, Eigen::RowMajor> plus;
    StateManifold().PlusJacobian(points.pointers[i], plus.data());
    J->middleCols<3>(column) = ambient.leftCols<3>();
    J->middleCols<3>(column + 3).noalias() = ambient.middleCols<4>(3) * plus.block<4, 3>(3, 3);
    J->middleCols<6>(column + 6) = ambient.rightCols<6>();
    column += kStateTangentSize;
  }
}

}  // namespace

bool Linearize(const Window& window, const Factor& factor, bool first_estimates,
               LinearFactor* linear) {
  const FactorBlocks blocks = window.Blocks(factor, false);
  const FactorBlocks points = window.Blocks(factor, first_estimates);
  std::array<double*, 6> jacobians{};
  if (!EvaluateWithJacobians(*factor.cost, points, &linear->r, &jacobians)) return false;
  if (first_estimates && points != blocks &&
      !factor.cost->Evaluate(blocks.data(), linear->r.data(), nullptr)) {
    return false;
  }
  const int columns = PlaceColumns(factor, window.layout().num_estimated(), linear);
  linear->J.resize(linear->r.size(), columns);
  WriteMinimal(factor, points, jacobians, &linear->J);
  if (factor.loss != nullptr) {
    double rho[3];
    factor.loss->Evaluate(linear->r.squaredNorm(), rho);
    const double weight = std::sqrt(rho[1]);
    linear->r *= weight;
    linear->J *= weight;
  }
  return linear->r.allFinite() && linear->J.allFinite();
}

std::optional<double> CostOf(const Window& window, const Factor& factor) {
  thread_local Eigen::VectorXd r;
  r.resize(factor.cost->num_residuals());
  const FactorBlocks blocks = window.Blocks(factor, false);
  if (!factor.cost->Evaluate(blocks.data(), r.data(), nullptr)) return std::nullopt;
  double rho[3] = {r.squaredNorm(), 1.0, 0.0};
  if (factor.loss != nullptr) factor.loss->Evaluate(r.squaredNorm(), rho);
  if (!std::isfinite(rho[0])) return std::nullopt;
  return 0.5 * rho[0];
}

Eigen::VectorXd PriorOffset(const Window& window) {
  const Prior& prior = window.prior();
  const int n = window.layout().num_estimated();
  Eigen::VectorXd d(prior.state_columns() + prior.bias_columns() + n);
  if (prior.has_state) {
    const Keyframe& oldest = window.keyframes().front();
    StateManifold().Minus(oldest.x.data(), oldest.x_lin.data(), d.data());
  }
  if (prior.has_bias) {
    const Bias& bias = window.bias(window.keyframes().front().bias);
    for (int i = 0; i < 6; ++i) d[prior.state_columns() + i] = bias.x[i] - bias.x_lin[i];
  }
  d.tail(n) = window.eta() - prior.eta_lin;
  return d;
}

Eigen::VectorXd PriorResidual(const Window& window) {
  return window.prior().b + window.prior().A * PriorOffset(window);
}

Eigen::MatrixXd PriorStateJacobian(const Window& window) {
  return StateColumnsAt(window.prior().A, PriorOffset(window).segment<3>(kTangentRotation));
}

MarginalizationFactor::MarginalizationFactor(const Window* window) : window_(window) {
  const Prior& prior = window->prior();
  set_num_residuals(static_cast<int>(prior.b.size()));
  if (prior.has_state) mutable_parameter_block_sizes()->push_back(kStateSize);
  if (prior.has_bias) mutable_parameter_block_sizes()->push_back(6);
  const int n = window->layout().num_estimated();
  if (n > 0) mutable_parameter_block_sizes()->push_back(n);
}

bool MarginalizationFactor::Evaluate(double const* const* blocks, double* residual,
                                     double** jacobians) const {
  const Prior& prior = window_->prior();
  Eigen::VectorXd d(prior.A.cols());
  int block = 0, column = 0;
  if (prior.has_state) {
    const Keyframe& oldest = window_->keyframes().front();
    StateManifold().Minus(blocks[0], oldest.x_lin.data(), d.data());
    if (jacobians != nullptr && jacobians[0] != nullptr) {
      const Eigen::MatrixXd minimal = StateColumnsAt(prior.A, d.segment<3>(kTangentRotation));
      WriteJacobian(StateManifold::Lift(minimal, blocks[0]), jacobians[0]);
    }
    ++block;
    column = kStateTangentSize;
  }
  const auto euclidean = [&](int size, const double* lin) {
    for (int i = 0; i < size; ++i) d[column + i] = blocks[block][i] - lin[i];
    if (jacobians != nullptr) WriteJacobian(prior.A.middleCols(column, size), jacobians[block]);
    ++block;
    column += size;
  };
  if (prior.has_bias) {
    euclidean(6, window_->bias(window_->keyframes().front().bias).x_lin.data());
  }
  if (prior.eta_lin.size() > 0) {
    euclidean(static_cast<int>(prior.eta_lin.size()), prior.eta_lin.data());
  }
  Eigen::Map<Eigen::VectorXd>(residual, prior.b.size()) = prior.b + prior.A * d;
  return true;
}

}  // namespace odmc
