#include "odmc/window/chain.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "odmc/factors/dynamics_factor.h"
#include "odmc/window/householder.h"

namespace odmc {

std::int64_t Chain::OldestRecent() const {
  return std::max(oldest(), newest() - options_->recent_keyframes);
}

void Chain::Clear() {
  fronts.clear();
  checkpoints.clear();
}

void Chain::DropOldest() {
  fronts.pop_front();
  while (!checkpoints.empty() && !fronts.empty() && checkpoints.front().id < oldest()) {
    checkpoints.pop_front();
  }
}

bool Chain::HasMoved(const Window& window, const ChainFront& f) const {
  std::array<double, kStateTangentSize> moved = f.delta;
  if (f.delta_version != f.point_version) {
    StateManifold().Minus(window.keyframe(f.id).x.data(), f.point.data(), moved.data());
  }
  for (int i = 0; i < kStateTangentSize; ++i) {
    if (std::abs(moved[i]) > options_->relinearise_state[i]) return true;
  }
  return false;
}

std::int64_t Chain::MovePoints(const Window& window, std::int64_t from) {
  std::int64_t first = -1;
  for (std::int64_t id = from; id <= newest(); ++id) {
    if (!HasMoved(window, front(id))) continue;
    front(id).MovePoint(window);
    if (first < 0) first = id;
  }
  return first;
}

bool Chain::Advance(const Window& window, std::int64_t id) {
  ++eliminated;
  ChainFront& f = front(id);
  ChainFront& next = front(id + 1);
  bool sound = f.Linearise(window, &next, point, point_version, true, &scratch);
  f.Eliminate(triangle, &root, &next, &scratch);
  Checkpoint& checkpoint = checkpoints.Append();
  checkpoint.id = next.id;
  checkpoint.root = root;
  while (checkpoints.front().id < newest() - options_->recent_keyframes) checkpoints.pop_front();
  const ChainFront* after = next.id < newest() ? &front(next.id + 1) : nullptr;
  sound = next.Linearise(window, after, point, point_version, false, &scratch) && sound;
  next.AbsorbOwn(&triangle, &root, &scratch);
  return sound;
}

bool Chain::Redo(const Window& window, std::int64_t from) {
  while (!checkpoints.empty() && checkpoints.back().id > from) checkpoints.pop_back();
  root = checkpoints.back().root;
  ChainFront& first = front(from);
  first.eliminated = false;
  const ChainFront* next = from < newest() ? &front(from + 1) : nullptr;
  bool sound = first.Linearise(window, next, point, point_version, false, &scratch);
  first.AbsorbOwn(&triangle, &root, &scratch);
  for (std::int64_t id = from; id < newest(); ++id) sound = Advance(window, id) && sound;
  return sound;
}

bool Chain::EliminateAll(const Window& window, const RootTriangle& before) {
  RestartFrom(oldest(), before);
  return Redo(window, oldest());
}

void Chain::RestartFrom(std::int64_t id, const RootTriangle& before) {
  checkpoints.clear();
  Checkpoint& checkpoint = checkpoints.Append();
  checkpoint.id = id;
  checkpoint.root = before;
}

void Chain::ObserveOldest(const Window& window, LeavingFactors* leaving) const {
  const int n = root.columns().n;
  const ChainFront& f = fronts.front();
  leaving->score.setZero(n);
  leaving->force_information.setZero(n);
  leaving->torque_information.setZero(n);
  const Keyframe& keyframe = window.keyframe(f.id);
  std::array<double, kStateTangentSize> own, next{};
  f.Offset(window, own.data());
  const bool has_next = fronts.size() > 1;
  if (has_next) fronts[1].Offset(window, next.data());
  for (size_t k = 0; k < f.kept().size(); ++k) {
    const Factor& factor = keyframe.factors[k];
    const ChainFront::KeptFactor& kept = f.kept()[k];
    if (!factor.parameters || !kept.sound || (kept.in_pair && !has_next)) continue;
    const RowBlock& block = kept.in_pair ? f.pair : f.own;
    const int parameters =
        (kept.in_pair ? f.border() : kStateTangentSize) + BorderColumns::kParameters;
    std::array<double, kMostFactorRows> residual;
    f.LinearResidual(window, factor, kept, own.data(), next.data(), residual.data());
    const auto* const dynamics = factor.As<DynamicsFactor>();
    const int torque_rows = dynamics != nullptr && dynamics->with_torque() ? 3 : 0;
    const double* corrected = f.corrected.row(static_cast<int>(k));
    leaving->score +=
        Eigen::Map<const Eigen::VectorXd>(corrected + f.border() + BorderColumns::kParameters, n);
    for (int i = 0; i < kept.rows; ++i) {
      const Eigen::Map<const Eigen::VectorXd> J(block.row(kept.row + i) + parameters, n);
      leaving->score += residual[static_cast<size_t>(i)] * J;
      if (dynamics == nullptr) continue;
      (i < kept.rows - torque_rows ? leaving->force_information : leaving->torque_information) +=
          J.cwiseAbs2();
    }
  }
}

bool Chain::NewestCovariance(StateMatrix* covariance) {
  // Rows [T S] of the state and R of the root: covariance T^-1 (I + Q Qᵀ) T^-ᵀ with Q R = S.
  const int shared = root.columns().pivots();
  StateMatrix sum = StateMatrix::Identity();
  scratch.pair.SetZero(kStateTangentSize, PaddedRow(shared));
  for (int i = 0; i < kStateTangentSize; ++i) {
    if (std::abs(triangle.row(i)[i]) < kLeastPivot) return false;
    double* q = scratch.pair.row(i);
    std::copy_n(triangle.row(i) + kStateTangentSize, shared, q);
    for (int j = 0; j < shared; ++j) {
      const double* r = root.row(j);
      if (std::abs(r[j]) < kLeastPivot) {
        if (std::abs(q[j]) > kLeastPivot) return false;
        continue;
      }
      q[j] /= r[j];
      for (int k = j + 1; k < shared; ++k) q[k] -= q[j] * r[k];
    }
    for (int k = 0; k <= i; ++k) {
      const double* other = scratch.pair.row(k);
      double dot = 0.0;
      for (int j = 0; j < shared; ++j) dot += q[j] * other[j];
      sum(i, k) += dot;
      if (k < i) sum(k, i) += dot;
    }
  }
  StateMatrix T = StateMatrix::Zero();
  for (int i = 0; i < kStateTangentSize; ++i) {
    for (int j = i; j < kStateTangentSize; ++j) T(i, j) = triangle.row(i)[j];
  }
  T.triangularView<Eigen::Upper>().solveInPlace(sum);
  *covariance = sum.transpose();
  T.triangularView<Eigen::Upper>().solveInPlace(*covariance);
  return covariance->allFinite();
}

}  // namespace odmc
