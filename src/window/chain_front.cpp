#include "odmc/window/chain_front.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "odmc/window/householder.h"

namespace odmc {
namespace {

constexpr int kState = kStateTangentSize;
constexpr int kBiasSize = 6;

/// rhs -= J x for a row-major J (rows×columns).
void SubtractProduct(const double* J, int rows, int columns, const double* x, double* rhs,
                     int stride) {
  for (int i = 0; i < rows; ++i) {
    double sum = 0.0;
    for (int j = 0; j < columns; ++j) sum += J[i * columns + j] * x[j];
    rhs[i * stride] -= sum;
  }
}

/// Writes a state's ambient Jacobian (rows×13) as the minimal one (rows×12).
void WriteMinimal(const double* ambient, int rows, const double* state, double* out, int stride) {
  double plus[12];  // 4×3
  RotationManifold().PlusJacobian(state + 3, plus);
  for (int i = 0; i < rows; ++i, ambient += kStateSize, out += stride) {
    for (int j = 0; j < 3; ++j) out[j] = ambient[j];
    const double* q = ambient + 3;
    for (int j = 0; j < 3; ++j) {
      out[3 + j] = q[0] * plus[j] + q[1] * plus[3 + j] + q[2] * plus[6 + j] + q[3] * plus[9 + j];
    }
    for (int j = 0; j < 6; ++j) out[6 + j] = ambient[7 + j];
  }
}

}  // namespace

void RowBlock::SetZero(int rows, int row_stride) {
  stride = row_stride;
  count = rows;
  data.resize(std::max(data.size(), static_cast<size_t>(rows * row_stride)));
  std::fill_n(data.begin(), rows * row_stride, 0.0);
}

void RowBlock::Extend(int rows) {
  const auto used = static_cast<size_t>(count * stride), size = used + rows * stride;
  data.resize(std::max(data.size(), size));
  std::fill(data.begin() + used, data.begin() + size, 0.0);
  count += rows;
}

void RowBlock::CopyFrom(const RowBlock& other) {
  stride = other.stride;
  count = other.count;
  const auto size = static_cast<size_t>(count * stride);
  data.resize(std::max(data.size(), size));
  std::memcpy(data.data(), other.data.data(), sizeof(double) * size);
}

void ChainFront::Reset(const Window& window, std::int64_t keyframe) {
  const Keyframe& k = window.keyframe(keyframe);
  id = keyframe;
  n_ = window.layout().num_estimated();
  bias_ = k.bias;
  point = k.x;
  ++point_version;
  conditional_version = next_version = -1;
  delta.fill(0.0);
  delta_version = point_version;
  message.SetZero(kState, PaddedRow(kState + BorderColumns(n_).size()));
  own.count = pair.count = rest.count = rest_before = 0;
  bias_leaves = eliminated = false;
  kept_.clear();
}

void ChainFront::MovePoint(const Window& window) {
  point = window.keyframe(id).x;
  ++point_version;
}

bool ChainFront::Linearise(const Window& window, const ChainFront* next,
                           const ParameterVector& parameter_point, int point_version_of_parameters,
                           FrontScratch* scratch) {
  const std::vector<Factor>& factors = window.keyframe(id).factors;
  const BorderColumns border_columns(n_);
  const bool leaves = next != nullptr && bias_ >= 0 && window.keyframe(next->id).bias != bias_;
  const auto is_pair = [](const Factor& f) { return f.state1 >= 0 || f.bias1 >= 0; };
  if (leaves != bias_leaves || kept_.size() > factors.size()) {  // other columns: all anew
    kept_.clear();
    own.count = pair.count = 0;
    bias_leaves = leaves;
  }
  if (kept_.empty()) {
    own.stride = PaddedRow(kState + border_columns.size());
    pair.stride = PaddedRow(border() + border_columns.size());
  }
  for (size_t i = kept_.size(); i < factors.size(); ++i) {
    RowBlock& block = is_pair(factors[i]) ? pair : own;
    kept_.push_back({is_pair(factors[i]), block.count, factors[i].cost->num_residuals()});
    block.Extend(kept_.back().rows);
  }
  bool sound = true;
  for (size_t i = 0; i < factors.size(); ++i) {
    const Factor& factor = factors[i];
    KeptFactor& kept = kept_[i];
    if (kept.in_pair && next == nullptr) continue;
    const int state0 = factor.state0 >= 0 ? point_version : -1;
    const int state1 = factor.state1 >= 0 ? next->point_version : -1;
    const int parameters =
        factor.parameters || factor.bias0 >= 0 ? point_version_of_parameters : -1;
    if (kept.sound && kept.revision == factor.revision && kept.state0 == state0 &&
        kept.state1 == state1 && kept.parameters == parameters) {
      continue;
    }
    RowBlock& block = kept.in_pair ? pair : own;
    kept.sound = Evaluate(window, factor, next, parameter_point, kept.in_pair, block.row(kept.row),
                          block.stride, scratch);
    sound = sound && kept.sound;
    kept.revision = factor.revision;
    kept.state0 = state0;
    kept.state1 = state1;
    kept.parameters = parameters;
  }
  return sound;
}

bool ChainFront::Evaluate(const Window& window, const Factor& factor, const ChainFront* next,
                          const ParameterVector& parameter_point, bool in_pair, double* rows,
                          int stride, FrontScratch* scratch) const {
  const ceres::CostFunction& cost = *factor.cost;
  const int num_rows = cost.num_residuals();
  const auto& sizes = cost.parameter_block_sizes();
  const BorderColumns columns(n_);
  const int border_at = in_pair ? border() : kState;
  for (int i = 0; i < num_rows; ++i) {
    std::fill_n(rows + i * stride, border_at + columns.size(), 0.0);
  }

  // The blocks, and the first column of each.
  std::array<const double*, 6> blocks{};
  std::array<int, 6> at{};
  int count = 0;
  const auto add = [&](const double* block, int column) {
    blocks[count] = block;
    at[count++] = column;
  };
  const auto bias_column = [&](std::int64_t bias) {
    return bias == bias_ && bias_leaves && in_pair ? kState : border_at + BorderColumns::kBias;
  };
  if (factor.state0 >= 0) add(point.data(), 0);
  if (factor.state1 >= 0) add(next->point.data(), pivots());
  const int states = count;
  if (factor.bias0 >= 0) add(window.bias(factor.bias0).x.data(), bias_column(factor.bias0));
  if (factor.bias1 >= 0) add(window.bias(factor.bias1).x.data(), bias_column(factor.bias1));
  if (factor.parameters && n_ > 0) {
    add(parameter_point.data(), border_at + BorderColumns::kParameters);
  }
  const double anchor = window.anchor();
  if (factor.anchored) add(&anchor, border_at + columns.anchor());

  size_t total = 0;
  for (const int size : sizes) total += static_cast<size_t>(num_rows * size);
  if (scratch->jacobians.size() < total) scratch->jacobians.resize(total);
  if (scratch->residual.size() < static_cast<size_t>(num_rows)) scratch->residual.resize(num_rows);
  std::array<double*, 6> jacobians{};
  double* end = scratch->jacobians.data();
  for (int i = 0; i < count; ++i) {
    jacobians[i] = end;
    end += num_rows * sizes[i];
  }
  double* r = scratch->residual.data();
  if (!cost.Evaluate(blocks.data(), r, jacobians.data())) return false;
  double finite = 0.0, squares = 0.0;  // NaN or infinity times zero is NaN
  for (const double* j = scratch->jacobians.data(); j != end; ++j) finite += 0.0 * *j;
  for (int i = 0; i < num_rows; ++i) squares += r[i] * r[i];
  if (!std::isfinite(finite + squares)) return false;

  const int rhs = border_at + columns.rhs();
  for (int i = 0; i < num_rows; ++i) rows[i * stride + rhs] = r[i];
  for (int k = 0; k < count; ++k) {
    if (k < states) {
      WriteMinimal(jacobians[k], num_rows, blocks[k], rows + at[k], stride);
      continue;
    }
    for (int i = 0; i < num_rows; ++i) {
      std::memcpy(rows + i * stride + at[k], jacobians[k] + i * sizes[k],
                  sizeof(double) * static_cast<size_t>(sizes[k]));
    }
    SubtractProduct(jacobians[k], num_rows, sizes[k], blocks[k], rows + rhs, stride);
  }
  if (factor.loss != nullptr) {
    double rho[3];
    factor.loss->Evaluate(squares, rho);
    const double weight = std::sqrt(rho[1]);
    if (weight != 1.0) {
      for (int i = 0; i < num_rows; ++i) {
        for (int j = 0; j <= rhs; ++j) rows[i * stride + j] *= weight;
      }
    }
  }
  return true;
}

void ChainFront::AbsorbOwn(RowBlock* triangle, RootTriangle* root, FrontScratch* scratch) {
  const BorderColumns columns(n_);
  triangle->CopyFrom(message);
  rest.stride = root->stride();
  rest.count = rest_before = own.count;
  const auto room = static_cast<size_t>((own.count + pair.count + 8) * rest.stride);
  if (rest.data.size() < room) rest.data.resize(room, 0.0);
  if (own.count == 0) return;
  scratch->own.CopyFrom(own);
  AbsorbRows(triangle->data.data(), triangle->stride, scratch->own.data.data(), scratch->own.stride,
             own.count, kState, kState + columns.size());
  for (int i = 0; i < own.count; ++i) {
    std::memcpy(rest.row(i), scratch->own.row(i) + kState,
                sizeof(double) * static_cast<size_t>(columns.size()));
  }
  root->Absorb(scratch->own.data.data() + kState, scratch->own.stride, own.count);
}

void ChainFront::Eliminate(const RowBlock& triangle, RootTriangle* root, ChainFront* next,
                           FrontScratch* scratch) {
  const BorderColumns columns(n_);
  const int p = pivots(), at = border(), width = at + columns.size();
  conditional.SetZero(p, PaddedRow(width));
  const auto doubles = [](int count) { return sizeof(double) * static_cast<size_t>(count); };
  // Border of a row before the bias leaves, written to the columns of the pair.
  const auto put_border = [&](const double* from, double* to) {
    if (!bias_leaves) {
      std::memcpy(to + at, from, doubles(columns.size()));
      return;
    }
    std::memcpy(to + kState, from, doubles(kBiasSize));
    std::memcpy(to + at + BorderColumns::kParameters, from + BorderColumns::kParameters,
                doubles(columns.size() - kBiasSize));
  };
  for (int i = 0; i < kState; ++i) {
    double* to = conditional.row(i);
    std::memcpy(to + i, triangle.row(i) + i, doubles(kState - i));
    put_border(triangle.row(i) + kState, to);
  }
  if (bias_leaves) {
    for (int i = 0; i < kBiasSize; ++i) put_border(root->row(i), conditional.row(kState + i));
    root->DropBias();
  }
  if (pair.count > 0) {
    scratch->pair.CopyFrom(pair);
    AbsorbRows(conditional.data.data(), conditional.stride, scratch->pair.data.data(),
               scratch->pair.stride, pair.count, p, width);
    const int taken =
        Triangularise(scratch->pair.data.data() + p, scratch->pair.stride, pair.count, kState,
                      kState + columns.size(), next->message.data.data(), next->message.stride);
    const int left = pair.count - taken;
    const auto room = static_cast<size_t>((rest_before + left) * rest.stride);
    if (rest.data.size() < room) rest.data.resize(room, 0.0);
    for (int i = 0; i < left; ++i) {
      std::memcpy(rest.row(rest_before + i), scratch->pair.row(taken + i) + at,
                  doubles(columns.size()));
    }
    rest.count = rest_before + left;
    root->Absorb(scratch->pair.data.data() + taken * scratch->pair.stride + at,
                 scratch->pair.stride, left);
  } else {
    next->message.SetZero(kState, next->message.stride);
    rest.count = rest_before;
  }
  conditional_point = point;
  conditional_version = point_version;
  next_point = next->point;
  next_version = next->point_version;
  eliminated = true;
}

void ChainFront::LeaveTo(RootTriangle* past, FrontScratch* scratch) const {
  if (rest.count == 0) {
    if (bias_leaves) past->DropBias();
    return;
  }
  scratch->own.CopyFrom(rest);
  past->Absorb(scratch->own.data.data(), rest.stride, rest_before);
  if (bias_leaves) past->DropBias();
  past->Absorb(scratch->own.data.data() + rest_before * rest.stride, rest.stride,
               rest.count - rest_before);
}

}  // namespace odmc
