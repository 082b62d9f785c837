#include "odmc/window/chain_front.h"

#include <Eigen/Core>
#include <algorithm>
#include <cassert>
#include <cmath>
#include <cstring>

#include "odmc/math/so3.h"
#include "odmc/window/householder.h"

namespace odmc {
namespace {

constexpr int kState = kStateTangentSize;
constexpr int kBiasSize = 6;
constexpr int kSpareRows = 8;  // of rest, for factors that are still to come
/// What corrections found at a leaving front moves what is past by no more, in any direction
/// [sigmas]: a young past knows some directions hardly at all.
constexpr double kMostLeft = 1.0;

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

void RowBlock::Reserve(int rows, int row_stride) {
  data.reserve(static_cast<size_t>(rows * row_stride));
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
  own.count = pair.count = rest.count = corrected.count = rest_before = 0;
  bias_leaves = eliminated = false;
  rest_gradient.assign(static_cast<size_t>(BorderColumns(n_).pivots()), 0.0);
  waiting.assign(static_cast<size_t>(kState + BorderColumns(n_).pivots()), 0.0);
  arrived.fill(0.0);
  waits = false;
  kept_.clear();
}

/// A bias leaves at another slot of the solver's ring every time: room in all of them, once.
void ChainFront::MakeRoomForLeavingBias() {
  constexpr int kPivots = kState + kBiasSize;
  const int row = PaddedRow(kPivots + kState + BorderColumns(n_).size());
  leaving_bias.Reserve(kBiasSize, PaddedRow(BorderColumns(n_).size()));
  conditional.Reserve(kPivots, row);
  pair.Reserve(pair.count + kBiasSize, row);  // and the walk to the next one
  corrected.Reserve(corrected.count + 1, row);
  kept_.reserve(kept_.size() + 1);
  rest.Reserve(own.count + pair.count + kBiasSize + kSpareRows,
               PaddedRow(BorderColumns(n_).size()));
}

void ChainFront::MovePoint(const Window& window) {
  point = window.keyframe(id).x;
  ++point_version;
}

void ChainFront::MovePointWithMessage(const Window& window, FrontScratch* scratch) {
  const std::array<double, kStateSize> from = point;
  MovePoint(window);
  Eigen::Matrix<double, kState, 1> d;
  StateManifold().Minus(point.data(), from.data(), d.data());
  if (d.isZero(0.0)) return;
  const Eigen::Matrix3d turn = RightJacobianInverse(d.segment<3>(kTangentRotation));
  const int rhs = kState + BorderColumns(n_).rhs();
  RowBlock& rows = scratch->own;
  rows.CopyFrom(message);
  for (int i = 0; i < kState; ++i) {
    double* row = rows.row(i);
    row[rhs] += Eigen::Map<const Eigen::Matrix<double, kState, 1>>(row).dot(d);
    Eigen::Map<Eigen::RowVector3d> of_rotation(row + kTangentRotation);
    of_rotation = (of_rotation * turn).eval();
  }
  Triangularise(rows.data.data(), rows.stride, kState, kState, rhs + 1, message.data.data(),
                message.stride);
}

bool ChainFront::Linearise(const Window& window, const ChainFront* next,
                           const ParameterVector& parameter_point, int point_version_of_parameters,
                           bool absorbed, FrontScratch* scratch) {
  const std::vector<Factor>& factors = window.keyframe(id).factors;
  const BorderColumns border_columns(n_);
  const bool leaves = next != nullptr && bias_ >= 0 && window.keyframe(next->id).bias != bias_;
  const auto is_pair = [](const Factor& f) { return f.state1 >= 0 || f.bias1 >= 0; };
  if (leaves != bias_leaves || kept_.size() > factors.size()) {  // other columns: all anew
    kept_.clear();
    own.count = pair.count = corrected.count = 0;
    bias_leaves = leaves;
  }
  if (kept_.empty()) {
    own.stride = PaddedRow(kState + border_columns.size());
    pair.stride = PaddedRow(border() + border_columns.size());
    corrected.stride = PaddedRow(border() + border_columns.pivots());
  }
  for (size_t i = kept_.size(); i < factors.size(); ++i) {
    RowBlock& block = is_pair(factors[i]) ? pair : own;
    kept_.push_back({is_pair(factors[i]), block.count, factors[i].cost->num_residuals()});
    assert(kept_.back().rows <= kMostFactorRows);
    block.Extend(kept_.back().rows);
    corrected.Extend(1);
  }
  if (bias_ >= 0 && !bias_leaves) MakeRoomForLeavingBias();
  bool sound = true;
  for (size_t i = 0; i < factors.size(); ++i) {
    const Factor& factor = factors[i];
    KeptFactor& kept = kept_[i];
    if (kept.in_pair ? next == nullptr : absorbed && kept.sound) continue;
    const int state0 = factor.state0 >= 0 ? point_version : -1;
    const int state1 = factor.state1 >= 0 ? next->point_version : -1;
    const int parameters =
        factor.parameters || factor.bias0 >= 0 ? point_version_of_parameters : -1;
    if (kept.sound && !kept.corrected && kept.revision == factor.revision &&
        kept.state0 == state0 && kept.state1 == state1 && kept.parameters == parameters) {
      continue;
    }
    kept.sound = Evaluate(window, factor, next, parameter_point, &kept, scratch);
    std::fill_n(corrected.row(static_cast<int>(i)), corrected.stride, 0.0);
    sound = sound && kept.sound;
    kept.corrected = false;
    kept.revision = factor.revision;
    kept.state0 = state0;
    kept.state1 = state1;
    kept.parameters = parameters;
  }
  return sound;
}

namespace {

/// What a factor is evaluated at, and the first column of each block in the rows.
struct PlacedBlocks {
  std::array<const double*, 6> blocks{};
  std::array<int, 6> at{};
  int count = 0;
  int states = 0;  // of these; they come first
  double anchor = 0.0;

  void Add(const double* block, int column) {
    blocks[static_cast<size_t>(count)] = block;
    at[static_cast<size_t>(count++)] = column;
  }
};

/// Residual and ambient Jacobians of a cost, in the scratch. @returns false if one is not finite
bool EvaluateCost(const ceres::CostFunction& cost, const PlacedBlocks& placed,
                  FrontScratch* scratch, std::array<double*, 6>* jacobians) {
  const int num_rows = cost.num_residuals();
  const auto& sizes = cost.parameter_block_sizes();
  size_t total = 0;
  for (const int size : sizes) total += static_cast<size_t>(num_rows * size);
  if (scratch->jacobians.size() < total) scratch->jacobians.resize(total);
  if (scratch->residual.size() < static_cast<size_t>(num_rows)) scratch->residual.resize(num_rows);
  double* end = scratch->jacobians.data();
  for (int i = 0; i < placed.count; ++i) {
    (*jacobians)[i] = end;
    end += num_rows * sizes[i];
  }
  const double* r = scratch->residual.data();
  if (!cost.Evaluate(placed.blocks.data(), scratch->residual.data(), jacobians->data())) {
    return false;
  }
  double finite = 0.0, squares = 0.0;  // NaN or infinity times zero is NaN
  for (const double* j = scratch->jacobians.data(); j != end; ++j) finite += 0.0 * *j;
  for (int i = 0; i < num_rows; ++i) squares += r[i] * r[i];
  return std::isfinite(finite + squares);
}

/// Writes them to rows, states' Jacobians minimal, the others' values taken off the right-hand
/// side.
void WriteRows(const PlacedBlocks& placed, const std::array<double*, 6>& jacobians,
               const std::vector<int>& sizes, const double* r, int num_rows, int rhs, double* rows,
               int stride) {
  for (int i = 0; i < num_rows; ++i) rows[i * stride + rhs] = r[i];
  for (int k = 0; k < placed.count; ++k) {
    const int at = placed.at[k];
    if (k < placed.states) {
      WriteMinimal(jacobians[k], num_rows, placed.blocks[k], rows + at, stride);
      continue;
    }
    for (int i = 0; i < num_rows; ++i) {
      std::memcpy(rows + i * stride + at, jacobians[k] + i * sizes[k],
                  sizeof(double) * static_cast<size_t>(sizes[k]));
    }
    SubtractProduct(jacobians[k], num_rows, sizes[k], placed.blocks[k], rows + rhs, stride);
  }
}

/// Weighs rows as a loss says. The weight is that of the residual at the present states, not at
/// their points.
/// @param offsets of each state from its point
/// @returns the weight
double Weigh(const ceres::LossFunction& loss, const PlacedBlocks& placed,
             const std::array<std::array<double, kStateTangentSize>, 2>& offsets, const double* r,
             int num_rows, int rhs, double* rows, int stride) {
  double squares = 0.0;
  for (int i = 0; i < num_rows; ++i) {
    const double* row = rows + i * stride;
    double at_estimate = r[i];
    for (int k = 0; k < placed.states; ++k) {
      for (int j = 0; j < kStateTangentSize; ++j) {
        at_estimate += row[placed.at[k] + j] * offsets[k][j];
      }
    }
    squares += at_estimate * at_estimate;
  }
  double rho[3];
  loss.Evaluate(squares, rho);
  const double weight = std::sqrt(rho[1]);
  if (weight != 1.0) {
    for (int i = 0; i < num_rows; ++i) {
      for (int j = 0; j <= rhs; ++j) rows[i * stride + j] *= weight;
    }
  }
  return weight;
}

}  // namespace

bool ChainFront::Evaluate(const Window& window, const Factor& factor, const ChainFront* next,
                          const ParameterVector& parameter_point, KeptFactor* kept,
                          FrontScratch* scratch) {
  const ceres::CostFunction& cost = *factor.cost;
  const bool in_pair = kept->in_pair;
  RowBlock& block_of_rows = in_pair ? pair : own;
  double* rows = block_of_rows.row(kept->row);
  const int stride = block_of_rows.stride;
  const int num_rows = cost.num_residuals();
  const BorderColumns columns(n_);
  const int border_at = in_pair ? border() : kState;
  for (int i = 0; i < num_rows; ++i) {
    std::fill_n(rows + i * stride, border_at + columns.size(), 0.0);
  }

  PlacedBlocks placed;
  const auto bias_column = [&](std::int64_t bias) {
    return bias == bias_ && bias_leaves && in_pair ? kState : border_at + BorderColumns::kBias;
  };
  if (factor.state0 >= 0) placed.Add(point.data(), 0);
  if (factor.state1 >= 0) placed.Add(next->point.data(), pivots());
  placed.states = placed.count;
  if (factor.bias0 >= 0) placed.Add(window.bias(factor.bias0).x.data(), bias_column(factor.bias0));
  if (factor.bias1 >= 0) placed.Add(window.bias(factor.bias1).x.data(), bias_column(factor.bias1));
  if (factor.parameters && n_ > 0) {
    placed.Add(parameter_point.data(), border_at + BorderColumns::kParameters);
  }
  placed.anchor = window.anchor();
  if (factor.anchored) placed.Add(&placed.anchor, border_at + columns.anchor());

  std::array<double*, 6> jacobians{};
  if (!EvaluateCost(cost, placed, scratch, &jacobians)) return false;
  const double* r = scratch->residual.data();
  const int rhs = border_at + columns.rhs();
  WriteRows(placed, jacobians, cost.parameter_block_sizes(), r, num_rows, rhs, rows, stride);
  if (factor.loss == nullptr) return true;
  std::array<std::array<double, kState>, 2> offsets;
  if (factor.state0 >= 0) Offset(window, offsets[0].data());
  if (factor.state1 >= 0) next->Offset(window, offsets[placed.states - 1].data());
  kept->weight = Weigh(*factor.loss, placed, offsets, r, num_rows, rhs, rows, stride);
  return true;
}

void ChainFront::AbsorbOwn(RowBlock* triangle, RootTriangle* root, FrontScratch* scratch) {
  const BorderColumns columns(n_);
  triangle->CopyFrom(message);
  std::fill(waiting.begin(), waiting.end(), 0.0);
  arrived.fill(0.0);
  waits = false;
  rest.stride = root->stride();
  rest.count = rest_before = own.count;
  const auto room = static_cast<size_t>((own.count + pair.count + kSpareRows) * rest.stride);
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
    leaving_bias.SetZero(kBiasSize, root->stride());
    for (int i = 0; i < kBiasSize; ++i) {
      put_border(root->row(i), conditional.row(kState + i));
      std::memcpy(leaving_bias.row(i), root->row(i), doubles(columns.size()));
    }
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
  std::fill(rest_gradient.begin(), rest_gradient.end(), 0.0);
  conditional_point = point;
  conditional_version = point_version;
  next_point = next->point;
  next_version = next->point_version;
  eliminated = true;
}

void ChainFront::Offset(const Window& window, double* d) const {
  if (delta_version == point_version) {
    std::copy(delta.begin(), delta.end(), d);
  } else {
    StateManifold().Minus(window.keyframe(id).x.data(), point.data(), d);
  }
}

void ChainFront::LinearResidual(const Window& window, const Factor& factor, const KeptFactor& kept,
                                const double* own_offset, const double* next_offset,
                                double* residual) const {
  const BorderColumns columns(n_);
  const RowBlock& block = kept.in_pair ? pair : own;
  const int at = kept.in_pair ? border() : kState;
  const int bias_at = kept.in_pair && bias_leaves ? kState : at + BorderColumns::kBias;
  for (int i = 0; i < kept.rows; ++i) {
    const double* row = block.row(kept.row + i);
    double r = row[at + columns.rhs()] + row[at + columns.anchor()] * window.anchor();
    for (int j = 0; j < kState; ++j) r += row[j] * own_offset[j];
    if (kept.in_pair) {
      for (int j = 0; j < kState; ++j) r += row[pivots() + j] * next_offset[j];
    }
    const auto add_bias = [&](std::int64_t which, int from) {
      if (which < 0) return;
      const auto& bias = window.bias(which).x;
      for (int j = 0; j < kBiasSize; ++j) r += row[from + j] * bias[static_cast<size_t>(j)];
    };
    add_bias(factor.bias0, bias_at);
    add_bias(factor.bias1, at + BorderColumns::kBias);
    const double* of_parameters = row + at + BorderColumns::kParameters;
    for (int j = 0; j < n_; ++j) r += of_parameters[j] * window.eta()[j];
    residual[i] = r;
  }
}

bool ChainFront::FollowWeights(const Window& window, const ChainFront& next, double most) {
  const std::vector<Factor>& factors = window.keyframe(id).factors;
  std::array<double, kState> own_offset, next_offset;
  Offset(window, own_offset.data());
  next.Offset(window, next_offset.data());
  bool moved = false;
  for (size_t k = 0; k < kept_.size(); ++k) {
    KeptFactor& kept = kept_[k];
    if (factors[k].loss == nullptr || !kept.sound || kept.revision != factors[k].revision) continue;
    std::array<double, kMostFactorRows> r;
    LinearResidual(window, factors[k], kept, own_offset.data(), next_offset.data(), r.data());
    double squares = 0.0, rho[3];
    for (int i = 0; i < kept.rows; ++i) squares += r[i] * r[i];
    factors[k].loss->Evaluate(squares / (kept.weight * kept.weight), rho);
    const double ratio = std::sqrt(rho[1]) / kept.weight;
    if (ratio < most && ratio * most > 1.0) continue;
    kept.revision = -1;
    moved = true;
  }
  return moved;
}

void ChainFront::Correct(const Window& window, ChainFront* next, FrontScratch* scratch,
                         double* found) {
  const std::vector<Factor>& factors = window.keyframe(id).factors;
  std::array<double, kState> own_offset, next_offset;
  Offset(window, own_offset.data());
  next->Offset(window, next_offset.data());
  StartGradient(scratch);
  bool changed = waits;
  for (size_t k = 0; k < kept_.size(); ++k) {
    const bool up_to_date = kept_[k].revision == factors[k].revision &&
                            kept_[k].state0 == point_version &&
                            (!kept_[k].in_pair || kept_[k].state1 == next->point_version);
    if (!factors[k].parameters || n_ == 0 || !kept_[k].sound || !up_to_date) continue;
    if (CorrectFactor(window, k, own_offset.data(), next_offset.data(), scratch)) changed = true;
  }
  if (changed) SubstituteGradient(next, scratch, found);
}

void ChainFront::PassOn(ChainFront* next, FrontScratch* scratch, double* found) {
  if (!waits) return;
  StartGradient(scratch);
  SubstituteGradient(next, scratch, found);
}

/// The scratch's gradient, in the pair's columns, becomes what waits.
void ChainFront::StartGradient(FrontScratch* scratch) const {
  const int at = border(), pivots_of_root = BorderColumns(n_).pivots();
  scratch->gradient.assign(static_cast<size_t>(at + pivots_of_root + kRowPadding), 0.0);
  scratch->taken.assign(static_cast<size_t>(pivots_of_root), 0.0);
  if (!waits) return;
  double* const g = scratch->gradient.data();
  std::copy_n(waiting.begin(), kState, g);
  // What waits of a leaving bias is among what was found of it.
  const int first = bias_leaves ? kBiasSize : 0;
  std::copy(waiting.begin() + kState + first, waiting.end(), g + at + first);
}

/// Takes the scratch's gradient through conditional and message.
void ChainFront::SubstituteGradient(ChainFront* next, FrontScratch* scratch, double* found) {
  const int pivots_of_root = BorderColumns(n_).pivots(), rhs = BorderColumns(n_).rhs();
  const int p = pivots(), at = border();
  double* const g = scratch->gradient.data();
  scratch->passing.assign(static_cast<size_t>(kState + pivots_of_root + kRowPadding), 0.0);
  double* const passing = scratch->passing.data();
  if (bias_leaves) {
    // What the root of the past makes of it when this front's bias leaves.
    for (int j = 0; j < kBiasSize; ++j) {
      const double of_bias = arrived[static_cast<size_t>(j)] + found[j];
      g[kState + j] += of_bias;
      passing[j] = of_bias - (waits ? waiting[static_cast<size_t>(kState + j)] : 0.0);
      found[j] = arrived[static_cast<size_t>(j)] = 0.0;
    }
    ForwardSubstitute(leaving_bias.data.data(), leaving_bias.stride, kBiasSize, pivots_of_root, -1,
                      passing);
    for (int j = kBiasSize; j < pivots_of_root; ++j) {
      rest_gradient[static_cast<size_t>(j)] -= passing[j];
    }
  }
  ForwardSubstitute(conditional.data.data(), conditional.stride, p, at + pivots_of_root, at + rhs,
                    g);
  std::copy_n(g + p, kState + pivots_of_root, passing);
  std::fill_n(passing + kState + pivots_of_root, kRowPadding, 0.0);
  RowBlock& message_to_next = next->message;
  ForwardSubstitute(message_to_next.data.data(), message_to_next.stride, kState,
                    kState + pivots_of_root, kState + rhs, passing);
  for (int i = 0; i < kState; ++i) next->waiting[static_cast<size_t>(i)] += g[p + i];
  for (int j = 0; j < pivots_of_root; ++j) {
    const auto k = static_cast<size_t>(kState + j);
    const bool other = bias_leaves && j < kBiasSize;  // what waits is of the bias before
    found[j] += g[at + j] - (waits && !other ? waiting[k] : 0.0);
    rest_gradient[static_cast<size_t>(j)] += passing[k];
    scratch->taken[static_cast<size_t>(j)] = g[at + j] - passing[k];
    next->waiting[k] += g[at + j] - passing[k];
  }
  next->waits = true;
  waits = false;
  std::fill(waiting.begin(), waiting.end(), 0.0);
}

/// Adds what factor k's gradient has changed by to the scratch's, in the pair's columns.
/// @returns false, nothing changed, if it cannot be evaluated here; its next linearization refuses
/// the update
bool ChainFront::CorrectFactor(const Window& window, size_t k, const double* own_offset,
                               const double* next_offset, FrontScratch* scratch) {
  const Factor& factor = window.keyframe(id).factors[k];
  KeptFactor& kept = kept_[k];
  const FactorBlocks blocks = window.Blocks(factor, false);
  std::vector<double>& jacobian = scratch->jacobians;
  const auto room = static_cast<size_t>(kept.rows * n_);
  if (jacobian.size() < room) jacobian.resize(room);
  std::array<double*, 6> jacobians{};
  jacobians[static_cast<size_t>(blocks.count - (factor.anchored ? 2 : 1))] = jacobian.data();
  std::array<double, kMostFactorRows> r, linear;
  if (!factor.cost->Evaluate(blocks.data(), r.data(), jacobians.data())) return false;
  double slope = 1.0, gain = 1.0;
  if (factor.loss != nullptr) {
    double squares = 0.0, rho[3];
    for (int i = 0; i < kept.rows; ++i) squares += r[i] * r[i];
    factor.loss->Evaluate(squares, rho);
    slope = rho[1];
    // Where its weight has grown, a whole step by the rows that there are would overshoot.
    gain = std::max(1.0, slope / (kept.weight * kept.weight));
  }
  LinearResidual(window, factor, kept, own_offset, next_offset, linear.data());
  const RowBlock& block = kept.in_pair ? pair : own;
  const int parameters = border() + BorderColumns::kParameters;
  const int in_block = (kept.in_pair ? border() : kState) + BorderColumns::kParameters;
  scratch->difference.assign(static_cast<size_t>(parameters + n_), 0.0);
  double* const difference = scratch->difference.data();
  for (int i = 0; i < kept.rows; ++i) {
    const double* J = jacobian.data() + i * n_;
    const double* row = block.row(kept.row + i);
    const double weighted = slope * r[i], more = weighted / kept.weight - linear[i];
    const int columns = in_block - (kept.in_pair ? 0 : kBiasSize);
    for (int j = 0; j < columns; ++j) difference[j] += more * row[j];
    for (int j = 0; j < (kept.in_pair ? 0 : kBiasSize); ++j) {  // the bias before one leaves
      difference[(bias_leaves ? kState : border()) + j] += more * row[kState + j];
    }
    row += in_block;
    for (int j = 0; j < n_; ++j) difference[parameters + j] += weighted * J[j] - linear[i] * row[j];
  }
  double sum = 0.0;
  for (int j = 0; j < parameters + n_; ++j) sum += difference[j];
  if (!std::isfinite(sum)) return false;
  kept.corrected = true;
  double* const before = corrected.row(static_cast<int>(k));
  double* const g = scratch->gradient.data();
  for (int j = 0; j < parameters + n_; ++j) {
    const double change = (difference[j] - before[j]) / gain;
    before[j] += change;
    g[j] += change;
  }
  return true;
}

void ChainFront::LeaveTo(RootTriangle* past, FrontScratch* scratch) const {
  RowBlock& rows = scratch->own;
  if (rest.count > 0) {
    rows.CopyFrom(rest);
    past->Absorb(rows.data.data(), rest.stride, rest_before);
  }
  if (bias_leaves) past->DropBias();
  if (rest.count > rest_before) {
    past->Absorb(rows.row(rest_before), rest.stride, rest.count - rest_before);
  }
  past->AddGradient(rest_gradient, kMostLeft);
}

}  // namespace odmc
