#include "odmc/window/chain_solution.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <utility>

#include "odmc/window/householder.h"

namespace odmc {
namespace {

constexpr int kState = kStateTangentSize;
constexpr double kBiasThreshold = 0.05;  // of biases for wildfire [rad/s, m/s²]
constexpr double kTighter = 2.0;         // from one try of damping to the next
constexpr double kTightest = 1e9;        // of a prior's sigma

double* BiasOf(Window* window, std::int64_t id) { return window->bias(id).x.data(); }

}  // namespace

void ChainSolution::Reset(const Window& window, int stride) {
  const auto border = static_cast<size_t>(stride);
  shared_.assign(border, 0.0);
  propagated_.assign(border, 0.0);
  border_.assign(border, 0.0);
  substituted_.assign(border + 2 * kState + 6 + kRowPadding, 0.0);
  for (int i = 0; i < window.layout().num_estimated(); ++i) {
    shared_[static_cast<size_t>(BorderColumns::kParameters + i)] = window.eta()[i];
  }
}

/// The candidate of `root`. @returns false if it is not a number
bool ChainSolution::SolveBorder(const RootTriangle& root, int anchor_entry, const Window& window) {
  root.Solve(anchor_entry, window.anchor(), border_.data());
  const auto end = border_.begin() + root.columns().size();
  return std::all_of(border_.begin(), end, [](double x) { return std::isfinite(x); });
}

/// True if the candidate is too far from `from` for a linear model.
bool ChainSolution::IsFar(const ParameterVector& from, const Window& window) const {
  for (int i = 0; i < from.size(); ++i) {
    const double eta = border_[static_cast<size_t>(BorderColumns::kParameters + i)];
    if (std::abs(eta - from[i]) > options_->largest_step * window.parameter_sigma()[i]) return true;
  }
  return false;
}

/// Holds the candidate to the point where the chain is linearized, in units of the priors' sigmas,
/// no harder than needed. @returns false if it is not a number
bool ChainSolution::Damp(const Window& window) {
  const ParameterVector& from = error_->in_use_at();
  for (double tighter = 1.0; IsFar(from, window); tighter *= kTighter) {
    damped_ = chain_->root;
    damped_.AbsorbPriors(from, window.parameter_sigma() / tighter);
    if (!SolveBorder(damped_, window.anchor_entry(), window) || tighter > kTightest) return false;
  }
  return true;
}

ChainSolution::Step ChainSolution::SolveRoot(LongSteps long_steps, Window* window) {
  if (!SolveBorder(chain_->root, window->anchor_entry(), *window)) return Step::kRefused;
  Step step = Step::kWhole;
  const bool damps = long_steps == LongSteps::kDamped;
  if (IsFar(window->eta(), *window) || (is_held_ && IsFar(error_->in_use_at(), *window))) {
    if (!damps || !Damp(*window)) return Step::kRefused;
    step = Step::kDamped;
    is_held_ = true;
  }
  TakeBorder(window);
  window->MoveAnchor();
  return step;
}

bool ChainSolution::SolveRootAtAnchor(Window* window) {
  if (!SolveBorder(chain_->root, -1, *window)) return false;
  TakeBorder(window);
  return true;
}

/// The candidate becomes the solution.
void ChainSolution::TakeBorder(Window* window) {
  std::swap(shared_, border_);
  for (int i = 0; i < chain_->root.columns().n; ++i) {
    window->eta()[i] = shared_[static_cast<size_t>(BorderColumns::kParameters + i)];
  }
  const std::int64_t bias = window->keyframes().back().bias;
  if (bias >= 0) std::copy_n(shared_.begin(), 6, BiasOf(window, bias));
}

/// Solves one front given the next. @returns the largest change, in thresholds
double ChainSolution::BackSubstitute(std::int64_t id, Window* window) {
  ++back_substituted;
  ChainFront& f = chain_->front(id);
  const BorderColumns& columns = chain_->root.columns();
  const Keyframe& keyframe = window->keyframe(id);
  const int p = f.eliminated ? f.pivots() : kState;
  const RowBlock& rows = f.eliminated ? f.conditional : chain_->triangle;
  const int at = f.eliminated ? f.border() : kState;
  // State (and leaving bias), next state, border.
  double* const x = substituted_.data();
  if (f.eliminated) {
    const ChainFront& after = chain_->front(id + 1);
    if (after.delta_version == f.next_version) {
      std::copy_n(after.delta.begin(), kState, x + p);
    } else {
      StateManifold().Minus(window->keyframe(id + 1).x.data(), f.next_point.data(), x + p);
    }
  }
  std::memcpy(x + at, shared_.data(), sizeof(double) * static_cast<size_t>(columns.size()));
  std::fill_n(x + at + columns.size(), kRowPadding, 0.0);
  // The bias behind the next state is that of the next keyframe.
  const std::int64_t bias =
      f.eliminated && f.bias_leaves ? window->keyframe(id + 1).bias : keyframe.bias;
  if (bias >= 0) std::copy_n(BiasOf(window, bias), 6, x + at);
  odmc::BackSubstitute(rows.data.data(), rows.stride, p, at + columns.size(), x);
  double change = 0.0;
  for (int i = 0; i < kState; ++i) {
    change = std::max(change, std::abs(x[i] - f.delta[i]) / options_->relinearise_state[i]);
    f.delta[i] = x[i];
  }
  f.delta_version = f.eliminated ? f.conditional_version : f.point_version;
  if (f.bias_leaves && f.eliminated) {
    std::copy_n(x + kState, 6, BiasOf(window, keyframe.bias));
  }
  const std::array<double, kStateSize>& from = f.eliminated ? f.conditional_point : f.point;
  StateManifold().Plus(from.data(), f.delta.data(), window->keyframe(id).x.data());
  return change;
}

/// True if states of the whole window may have to follow.
bool ChainSolution::SharedHaveMoved() const {
  const auto has_moved = [this](int i, double threshold) {
    const auto k = static_cast<size_t>(i);
    return std::abs(shared_[k] - propagated_[k]) > options_->wildfire * threshold;
  };
  for (int i = 0; i < chain_->root.columns().n; ++i) {
    if (has_moved(BorderColumns::kParameters + i, error_->sigma[i])) return true;
  }
  for (int i = 0; i < BorderColumns::kParameters; ++i) {
    if (has_moved(i, kBiasThreshold)) return true;
  }
  return false;
}

bool ChainSolution::BackSubstitute(Window* window, bool everything) {
  const std::int64_t oldest = chain_->oldest(), newest = chain_->newest();
  if ((everything || SharedHaveMoved()) && pass_ < 0) {
    propagated_ = shared_;
    pass_ = newest;
  }
  // What the newest measurements change, as far as it reaches.
  const std::int64_t recent = chain_->OldestRecent();
  bool has_left = false;
  std::int64_t id = newest;
  int left =
      everything ? static_cast<int>(chain_->fronts.size()) : options_->back_substituted_keyframes;
  for (; id >= oldest; --id) {
    const double change = BackSubstitute(id, window);
    if (id < recent && id > oldest && !has_left) {
      has_left = chain_->HasMoved(*window, chain_->front(id));
    }
    if (--left <= 0 || (id <= recent && change < options_->wildfire)) break;
  }
  // What shared variables change, over the whole window.
  if (pass_ >= id) pass_ = id - 1;
  if (everything) {
    for (; pass_ >= oldest; --pass_) BackSubstitute(pass_, window);
  }
  for (; pass_ >= oldest && left > 0; --pass_, --left) BackSubstitute(pass_, window);
  if (pass_ < oldest) pass_ = -1;
  return has_left;
}

}  // namespace odmc
