#include "odmc/window/incremental_window_solver.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>

#include "odmc/factors/dynamics_factor.h"
#include "odmc/window/householder.h"

namespace odmc {
namespace {

constexpr int kState = kStateTangentSize;
constexpr double kFirstCurvature = 3.0;   // error in tolerances at a distance of one sigma
constexpr double kLeastCurvature = 0.05;  // a new manoeuvre may bring more than the last sweep saw
constexpr double kCurvatureMemory = 0.5;  // from one sweep to the next
constexpr double kAllowedError = 0.5;     // of a tolerance, before it hurries
constexpr double kWorthwhile = 0.2;       // of a tolerance, before a sweep is
constexpr double kSettled = 0.05;         // where further iterations were asked for [sigmas]
constexpr double kFirstBend = 0.3;        // error [sigmas] of fronts evaluated a sigma away
constexpr double kBendMemory = 0.7;
constexpr size_t kSoonInTurn = 5;         // updates: short windows need no more than their turn
constexpr double kWeightMoved = 1.1;      // of a recent factor: root of the robust loss' slope
constexpr double kLeastHopeForCorrection = 0.3;         // to be corrected [sigmas]
constexpr double kLeastDistance = 0.01;   // to learn it from [sigmas]
constexpr double kBiasThreshold = 0.05;   // of biases for wildfire [rad/s, m/s²]
constexpr double kIntolerable = 0.8;      // before it takes all the time there is
constexpr int kFaster = 4;                // sweep where errors are not allowed
constexpr size_t kMostHurried = 250;      // keyframes; in longer windows parameters move less
constexpr int kMostHurriedSweeps = 4;     // in one update
constexpr double kAlignmentTolerance = 1e-4;  // of its cost; the chain takes the last step
constexpr int kAlignmentIterations = 10;  // of the batch solve

/// How errors of a linearization grow with the distance [sigmas] from its point: as its square, but
/// for small ones, where other errors are larger.
double CurvedDistance(double distance) { return distance * std::max(1.0, distance); }

/// The distance [sigmas] at which they reach `error`, both in tolerances.
double DistanceAt(double error, double curvature) {
  const double bend = error / curvature;
  return bend < 1.0 ? bend : std::sqrt(bend);
}

double* BiasOf(Window* window, std::int64_t id) { return window->bias(id).x.data(); }

}  // namespace

IncrementalWindowSolver::IncrementalWindowSolver(const IncrementalOptions& options)
    : options_(options) {}
IncrementalWindowSolver::~IncrementalWindowSolver() = default;

// ---- Between the batch solve and the chain ------------------------------------------------------

/// True if the fronts are those of the window's oldest keyframes.
bool IncrementalWindowSolver::Follows(const Window& window) const {
  if (!incremental_ || past_.columns().n != window.layout().num_estimated()) return false;
  if (fronts_.empty()) return true;
  return !window.keyframes().empty() && fronts_.front().id == window.keyframes().front().id &&
         fronts_.size() <= window.keyframes().size();
}

void IncrementalWindowSolver::Forget() {
  incremental_ = false;
  fronts_.clear();
  checkpoints_.clear();
  sweep_.active = sweep_.wanted = sweep_.urgent = sweep_.reweighs = false;
  segments_.clear();
  have_root_ = false;
  curvature_ = kFirstCurvature;
  pass_ = -1;
  batch_.Forget();
}

/// The window's prior becomes the message to the oldest keyframe and what is past.
void IncrementalWindowSolver::ReadPrior(const Window& window) {
  const int n = window.layout().num_estimated();
  past_.Clear(n);
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
  if (!fronts_.empty()) {
    RowBlock& message = fronts_.front().message;
    taken = Triangularise(block.data.data(), block.stride, rows, kState, kState + border.size(),
                          message.data.data(), message.stride);
  }
  past_.Absorb(block.data.data() + taken * block.stride + kState, block.stride, rows - taken);
}

void IncrementalWindowSolver::WritePrior(Window* window) {
  if (incremental_) WritePrior(sweep_.reweighs ? sweep_.past : past_, window);
}

void IncrementalWindowSolver::WritePrior(const RootTriangle& past, Window* window) const {
  const int n = window->layout().num_estimated();
  Prior& prior = window->prior();
  prior = Prior();
  prior.eta_lin = window->eta();
  const bool any = !fronts_.empty();
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
    const ChainFront& oldest = fronts_.front();
    for (int i = 0; i < kState; ++i) {
      for (int j = i; j < kState; ++j) prior.A(row, j) = oldest.message.row(i)[j];
      put_border(oldest.message.row(i) + kState);
    }
    Keyframe& keyframe = window->keyframes().front();
    keyframe.in_prior = true;
    keyframe.x_lin = oldest.point;
  }
  if (prior.has_bias) {
    Bias& in_prior = window->bias(bias);
    in_prior.in_prior = true;
    in_prior.x_lin = in_prior.x;
    for (int i = 0; i < 6; ++i) put_border(past.row(i));
  }
  for (int i = 0; i < n; ++i) put_border(past.row(BorderColumns::kParameters + i));
}

/// Makes the chain from the window as it stands.
bool IncrementalWindowSolver::Build(Window* window) {
  Forget();
  const int n = window->layout().num_estimated();
  for (const Keyframe& keyframe : window->keyframes()) AppendFront(*window, keyframe.id);
  if (!fronts_.empty() && window->prior().has_state) {
    fronts_.front().point = window->keyframes().front().x_lin;
    fronts_.front().delta_version = -1;  // the state is elsewhere
  }
  ReadPrior(*window);
  incremental_ = true;
  window->TakeTouched();
  window->MoveAnchor();
  const auto border = static_cast<size_t>(past_.stride());
  shared_.assign(border, 0.0);
  propagated_.assign(border, 0.0);
  border_.assign(border, 0.0);
  substituted_.assign(border + 2 * kState + 6 + kRowPadding, 0.0);
  found_.assign(static_cast<size_t>(past_.columns().pivots()), 0.0);
  for (int i = 0; i < n; ++i) shared_[BorderColumns::kParameters + i] = window->eta()[i];
  pending_.setZero(n, n + 2);
  has_pending_ = false;
  if (sigma_.size() != n) sigma_ = window->parameter_sigma();
  if (fronts_.empty()) {
    root_ = past_;
    root_.AbsorbPriors(window->parameter_centre(), window->parameter_sigma());
    in_use_at_ = sweep_.begun_at = window->eta();
    return true;
  }
  in_use_at_ = window->eta();
  return SweepAll(window);
}

/// Puts the past back into the window, for the batch solver.
void IncrementalWindowSolver::HandBack(Window* window) {
  ApplyPending();
  FinishReweighing(window);
  if (Follows(*window)) WritePrior(past_, window);
  Forget();
}

SolveReport IncrementalWindowSolver::Align(Window* window, const SolverOptions& options) {
  // Asked for, it solves the same problem better; factors that were touched, or a step too long for
  // a linear model, make another problem of it.
  const bool is_same = options.align && window->TakeTouched() < 0;
  const double curvature = is_same ? curvature_ : kFirstCurvature;
  HandBack(window);
  SolverOptions thorough = options;
  thorough.max_iterations = std::max(options.max_iterations, kAlignmentIterations);
  // From there the chain, which tells the covariance, takes the last step.
  thorough.function_tolerance = std::max(options.function_tolerance, kAlignmentTolerance);
  SolveReport report = batch_.Solve(window, thorough);
  report.aligned = true;
  if (!report.usable || window->keyframes().empty()) return report;
  if (!Build(window)) {
    HandBack(window);
    return report;
  }
  curvature_ = curvature;
  if (SolveRoot(window)) BackSubstitute(window, true);
  return report;
}

// ---- The chain ----------------------------------------------------------------------------------

void IncrementalWindowSolver::AppendFront(const Window& window, std::int64_t id) {
  ChainFront& added = fronts_.Append();
  added.Reset(window, id);
  if (!segments_.empty() && id < segments_.back().first + options_.segment_keyframes) return;
  Segment& segment = segments_.Append();
  segment.first = id;
  segment.at = window.eta();
  segment.bend = kFirstBend;
}

std::int64_t IncrementalWindowSolver::OldestRecent() const {
  return std::max(fronts_.front().id, fronts_.back().id - options_.recent_keyframes);
}

/// Eliminates front `id`, the chain's last one so far, given triangle_ and root_; enters the next.
bool IncrementalWindowSolver::Advance(const Window& window, std::int64_t id) {
  ++report_.eliminated;
  ChainFront& f = front(id);
  ChainFront& next = front(id + 1);
  bool sound = f.Linearise(window, &next, point_, point_version_, true, &scratch_);
  f.Eliminate(triangle_, &root_, &next, &scratch_);
  Checkpoint& checkpoint = checkpoints_.Append();
  checkpoint.id = next.id;
  checkpoint.root = root_;
  while (checkpoints_.front().id < fronts_.back().id - options_.recent_keyframes) {
    checkpoints_.pop_front();
  }
  const ChainFront* after = next.id < fronts_.back().id ? &front(next.id + 1) : nullptr;
  sound = next.Linearise(window, after, point_, point_version_, false, &scratch_) && sound;
  next.AbsorbOwn(&triangle_, &root_, &scratch_);
  return sound;
}

/// Eliminates the chain anew from front `from` on, which has a checkpoint.
bool IncrementalWindowSolver::Redo(const Window& window, std::int64_t from) {
  while (!checkpoints_.empty() && checkpoints_.back().id > from) checkpoints_.pop_back();
  root_ = checkpoints_.back().root;
  ChainFront& first = front(from);
  first.eliminated = false;
  const ChainFront* next = from < fronts_.back().id ? &front(from + 1) : nullptr;
  bool sound = first.Linearise(window, next, point_, point_version_, false, &scratch_);
  first.AbsorbOwn(&triangle_, &root_, &scratch_);
  for (std::int64_t id = from; id < fronts_.back().id; ++id) sound = Advance(window, id) && sound;
  return sound;
}

bool IncrementalWindowSolver::HasMoved(const Window& window, const ChainFront& f) const {
  std::array<double, kState> moved = f.delta;
  if (f.delta_version != f.point_version) {
    StateManifold().Minus(window.keyframe(f.id).x.data(), f.point.data(), moved.data());
  }
  for (int i = 0; i < kState; ++i) {
    if (std::abs(moved[i]) > options_.relinearise_state[i]) return true;
  }
  return false;
}

/// Moves the linearization points of states that have left theirs, from front `from` on. Their
/// fronts and the one before must be eliminated anew. @returns the first of them, -1: none
std::int64_t IncrementalWindowSolver::MovePoints(const Window& window, std::int64_t from) {
  std::int64_t first = -1;
  for (std::int64_t id = from; id <= fronts_.back().id; ++id) {
    if (!HasMoved(window, front(id))) continue;
    front(id).MovePoint(window);
    if (first < 0) first = id;
  }
  return first;
}

/// Linearizes newest states that have moved anew, and what was touched.
bool IncrementalWindowSolver::RedoMovedRecent(Window* window) {
  const std::int64_t newest = fronts_.back().id;
  const std::int64_t oldest = std::max(OldestRecent(), checkpoints_.front().id);
  std::int64_t from = newest + 1;
  const std::int64_t touched = window->TakeTouched();
  if (touched >= 0) {
    if (touched < oldest) {  // a sweep under way may have passed it
      curvature_ = std::max(curvature_, kFirstCurvature);
      StartSweep(*window);
      sweep_.urgent = true;
    }
    from = std::max(touched, oldest);
  }
  // With the factors to the state before.
  const std::int64_t moved = MovePoints(*window, oldest + 1);
  if (moved >= 0) from = std::min(from, moved - 1);
  for (std::int64_t id = oldest; id < std::min(from, newest); ++id) {
    if (!front(id).FollowWeights(*window, front(id + 1), kWeightMoved)) continue;
    from = id;
    break;
  }
  if (Distance(*window, recent_at_) > options_.relinearise_recent) from = std::min(from, oldest);
  if (from > newest) return true;
  if (from <= oldest) recent_at_ = window->eta();
  return Redo(*window, from);
}

// ---- The sweep ----------------------------------------------------------------------------------

void IncrementalWindowSolver::StartSweep(const Window& window) {
  ApplyPending();
  sweep_.active = true;
  sweep_.wanted = false;
  sweep_.next = fronts_.front().id;
  sweep_.root = past_;
  sweep_.root.AbsorbPriors(window.parameter_centre(), window.parameter_sigma());
  sweep_.begun_at = window.eta();
}

/// Eliminates the sweep's next front.
bool IncrementalWindowSolver::SweepOne(Window* changed) {
  const Window& window = *changed;
  if (sweep_.reweighs) sweep_.weigh(&changed->keyframe(sweep_.next));
  ++report_.eliminated;
  ChainFront& f = front(sweep_.next);
  ChainFront& next = front(sweep_.next + 1);
  if (HasMoved(window, next)) next.MovePoint(window);
  const bool sound = f.Linearise(window, &next, point_, point_version_, false, &scratch_);
  f.AbsorbOwn(&sweep_triangle_, &sweep_.root, &scratch_);
  f.Eliminate(sweep_triangle_, &sweep_.root, &next, &scratch_);
  ++sweep_.next;
  const std::int64_t passed = (sweep_.next - segments_.front().first) / options_.segment_keyframes;
  Segment& segment = segments_[static_cast<size_t>(std::max<std::int64_t>(passed - 1, 0))];
  if (passed > 0 && segment.first + options_.segment_keyframes == sweep_.next) segment.at = point_;
  return sound;
}

int IncrementalWindowSolver::SweepSize() const {
  const auto share = static_cast<int>(options_.sweep_share * static_cast<double>(fronts_.size()));
  return std::max(options_.sweep_keyframes, share);
}

/// What the sweep has not weighed anew yet.
void IncrementalWindowSolver::FinishReweighing(Window* window) {
  if (!sweep_.reweighs) return;
  for (Keyframe& keyframe : window->keyframes()) {
    if (keyframe.id >= sweep_.next) sweep_.weigh(&keyframe);
  }
}

/// Brings parameters' point of linearization to the present estimate.
void IncrementalWindowSolver::MoveParameterPoint(const Window& window) {
  if (point_.size() == window.eta().size() &&
      !ParametersMoved(window, point_, options_.same_point, options_.same_point)) {
    return;
  }
  point_ = window.eta();
  ++point_version_;
}

/// @param corrects the fronts it takes; else the chain in use should soon be done with
bool IncrementalWindowSolver::Sweep(Window* changed, int budget, bool corrects) {
  const Window& window = *changed;
  if (corrects) CorrectBeforeSweep(window, sweep_.next + budget);
  bool sound = true;
  MoveParameterPoint(window);
  for (int i = 0; i < budget && sweep_.active; ++i) {
    if (sweep_.next < OldestRecent()) sound = SweepOne(changed) && sound;
    if (sweep_.next < OldestRecent()) continue;
    // It has caught up: the rest at once, from here on it is the chain in use.
    FinishReweighing(changed);
    const bool known =
        have_root_ && !sweep_.urgent && !sweep_.reweighs && SolutionOf(window, &before_);
    sweep_.has_reweighed = sweep_.reweighs;
    sweep_.active = sweep_.urgent = sweep_.reweighs = false;
    checkpoints_.clear();
    Checkpoint& checkpoint = checkpoints_.Append();
    checkpoint.id = sweep_.next;
    checkpoint.root = sweep_.root;
    MovePoints(window, sweep_.next + 1);
    recent_at_ = window.eta();
    sound = Redo(window, sweep_.next) && sound;
    have_root_ = true;
    if (known && SolutionOf(window, &after_)) LearnCurvature();
    in_use_at_ = sweep_.begun_at;
  }
  return sound;
}

// ---- Corrections --------------------------------------------------------------------------------

/// Evaluates a segment's older fronts at the present estimate; the roots take what that changes.
void IncrementalWindowSolver::CorrectSegment(const Window& window, Segment* segment) {
  std::fill(found_.begin(), found_.end(), 0.0);
  std::int64_t oldest = std::max(segment->first, fronts_.front().id);
  // Fronts that have weights which the chain in use does not have wait until it does.
  if (sweep_.reweighs) oldest = std::max(oldest, sweep_.next);
  const std::int64_t recent = checkpoints_.front().id;
  const std::int64_t end = std::min(segment->first + options_.segment_keyframes, recent);
  segment->expected = 0.0;
  segment->turn = ++turn_;
  if (end <= oldest) {  // all are recent, or have just been swept
    if (segment->first >= recent) segment->at = window.eta();
    return;
  }
  for (std::int64_t id = oldest; id < end; ++id) {
    if (sweep_.active && id == sweep_.next && id > oldest) GiveFoundTo(&sweep_.root);
    front(id).Correct(window, &front(id + 1), &scratch_, found_.data());
  }
  const double change = GiveFoundToRoots(window, end);
  const double distance = Distance(window, segment->at);
  if (distance > kLeastDistance) {
    segment->bend = std::max(change / distance, kBendMemory * segment->bend);
  }
  segment->at = window.eta();
}

/// Brings the gradients of the fronts that the sweep is about to take up to date: the chain in use
/// goes on with these until the sweep is through.
void IncrementalWindowSolver::CorrectBeforeSweep(const Window& window, std::int64_t end) {
  if (!sweep_.active || !have_root_ || checkpoints_.empty()) return;
  const bool is_last = end >= OldestRecent();
  if (is_last || sweep_.urgent) return;
  std::fill(found_.begin(), found_.end(), 0.0);
  for (std::int64_t id = sweep_.next; id < end; ++id) {
    front(id).Correct(window, &front(id + 1), &scratch_, found_.data());
  }
  GiveFoundToRoots(window, end);
}

/// A root takes what was found at fronts before its next one. What went with the message to that
/// one it will absorb there.
void IncrementalWindowSolver::GiveFoundTo(RootTriangle* root) {
  given_ = found_;
  for (size_t j = 0; j < given_.size(); ++j) given_[j] -= scratch_.taken[j];
  root->AddGradient(given_);
}

/// All roots take what was found at fronts before `end`; those of a later bias only what is about
/// the parameters. @returns how far the optimum moves [sigmas]
double IncrementalWindowSolver::GiveFoundToRoots(const Window& window, std::int64_t end) {
  const std::int64_t bias = window.keyframe(end).bias;
  const auto give = [&](RootTriangle* root, std::int64_t before) {
    const bool same = window.keyframe(before).bias == bias;
    if (same && before == end) {
      GiveFoundTo(root);
      return 0.0;
    }
    given_ = found_;
    if (!same) std::fill_n(given_.begin(), BorderColumns::kParameters, 0.0);
    return root->AddGradient(given_);
  };
  if (sweep_.active && end <= sweep_.next) give(&sweep_.root, sweep_.next);
  for (Checkpoint& checkpoint : checkpoints_) give(&checkpoint.root, checkpoint.id);
  const std::int64_t newest = fronts_.back().id;
  if (window.keyframe(newest).bias != bias) {
    // It waits where its bias leaves.
    std::int64_t id = end;
    while (id < newest && !front(id).bias_leaves) ++id;
    for (size_t j = 0; j < 6; ++j) front(id).arrived[j] += found_[j];
    front(id).waits = true;
  }
  return give(&root_, newest);
}

/// The largest distance of a parameter from `at` [sigmas].
double IncrementalWindowSolver::Distance(const Window& window, const ParameterVector& at) const {
  return (window.eta() - at).cwiseQuotient(sigma_).cwiseAbs().maxCoeff();
}

/// Errors that segments make because parameters have moved since they were evaluated. @returns all
/// together [sigmas]
double IncrementalWindowSolver::ExpectErrors(const Window& window) {
  double squares = 0.0;
  for (Segment& segment : segments_) {
    segment.expected = segment.bend * Distance(window, segment.at);
    squares += segment.expected * segment.expected;
  }
  return std::sqrt(squares);
}

/// Corrects one portion in turn and then the segments that need it most, each once at most; `all`:
/// every one, as far as time goes.
/// @returns false if the step is too long for a linear model
template <typename InTime>
bool IncrementalWindowSolver::Correct(Window* window, const InTime& in_time, bool all) {
  if (checkpoints_.empty() || options_.corrected_segments == 0) return true;
  const std::int64_t before = turn_;
  const double expected_before = ExpectErrors(*window);
  for (bool first = true;; first = false) {
    Segment* chosen = nullptr;
    for (int i = 0; i < options_.corrected_segments; ++i) {
      chosen = nullptr;
      for (Segment& segment : segments_) {
        if (segment.turn > before) continue;  // done
        // In turn: states move as well, and weights are followed step by step.
        const bool better = chosen == nullptr || (first ? segment.turn < chosen->turn
                                                        : segment.expected > chosen->expected);
        if (better) chosen = &segment;
      }
      if (chosen == nullptr) break;
      CorrectSegment(*window, chosen);
    }
    if (!SolveRoot(window)) return false;
    if (all && chosen != nullptr && in_time()) continue;
    const double expected = ExpectErrors(*window);
    if (expected < options_.allowed_lag || chosen == nullptr || !in_time()) return true;
    const size_t in_turn = kSoonInTurn * static_cast<size_t>(options_.corrected_segments);
    if (segments_.size() <= in_turn && !sweep_.has_reweighed) return true;
    if (expected > std::max(expected_before, kLeastHopeForCorrection)) {
      sweep_.urgent = true;  // by Jacobians this old it might not converge
      return true;
    }
  }
}

/// Parameters and their sigmas by the root as it stands.
bool IncrementalWindowSolver::SolutionOf(const Window& window, Solution* solution) {
  if (!root_.Covariance(&covariance_)) return false;
  root_.Solve(window.anchor_entry(), window.anchor(), border_.data());
  const int n = past_.columns().n;
  solution->eta = Eigen::Map<const Eigen::VectorXd>(border_.data() + BorderColumns::kParameters, n);
  solution->sigma = covariance_.diagonal().cwiseSqrt();
  return true;
}

/// What a new linearization of the same data changed tells how far the next may be put off.
void IncrementalWindowSolver::LearnCurvature() {
  const auto& sigma = after_.sigma;
  const double distance = (sweep_.begun_at - in_use_at_).cwiseQuotient(sigma).cwiseAbs().maxCoeff();
  if (distance < 0.1) return;  // nothing to learn from
  const double sigmas = (before_.sigma.cwiseQuotient(sigma).array() - 1.0).abs().maxCoeff();
  const double measured = sigmas / options_.sigma_tolerance;
  curvature_ =
      std::max({measured / CurvedDistance(distance), kCurvatureMemory * curvature_, kLeastCurvature});
}

/// True if putting the relinearization off might cost more than `error` tolerances.
bool IncrementalWindowSolver::MayCost(double error, const Window& window) const {
  if (sweep_.urgent) return true;
  return ParametersMoved(window, in_use_at_, DistanceAt(error, curvature_),
                         options_.relinearise_share);
}

bool IncrementalWindowSolver::SweepAll(Window* window) {
  StartSweep(*window);
  return Sweep(window, static_cast<int>(fronts_.size()) + 1);
}

// ---- The solution -------------------------------------------------------------------------------

/// Shared variables from the root. @returns false, leaving the window, if the step is too long for
/// a linear model or not a number
bool IncrementalWindowSolver::SolveRoot(Window* window) {
  root_.Solve(window->anchor_entry(), window->anchor(), border_.data());
  const int n = past_.columns().n;
  const double* eta = border_.data() + BorderColumns::kParameters;
  for (int i = 0; i < past_.columns().size(); ++i) {
    if (!std::isfinite(border_[static_cast<size_t>(i)])) return false;
  }
  for (int i = 0; i < n; ++i) {
    const double step = std::abs(eta[i] - window->eta()[i]);
    if (step > options_.largest_step * window->parameter_sigma()[i]) return false;
  }
  std::swap(shared_, border_);
  for (int i = 0; i < n; ++i) {
    window->eta()[i] = shared_[static_cast<size_t>(BorderColumns::kParameters + i)];
  }
  window->MoveAnchor();
  const std::int64_t bias = window->keyframes().back().bias;
  if (bias >= 0) std::copy_n(shared_.begin(), 6, BiasOf(window, bias));
  return true;
}

void IncrementalWindowSolver::StoreState(ChainFront* f, Window* window) {
  const std::array<double, kStateSize>& at = f->eliminated ? f->conditional_point : f->point;
  StateManifold().Plus(at.data(), f->delta.data(), window->keyframe(f->id).x.data());
}

/// Solves one front given the next. @returns the largest change, in thresholds
double IncrementalWindowSolver::BackSubstitute(std::int64_t id, Window* window) {
  ++report_.back_substituted;
  ChainFront& f = front(id);
  const BorderColumns& columns = past_.columns();
  const Keyframe& keyframe = window->keyframe(id);
  const int p = f.eliminated ? f.pivots() : kState;
  const RowBlock& rows = f.eliminated ? f.conditional : triangle_;
  const int at = f.eliminated ? f.border() : kState;
  // State (and leaving bias), next state, border.
  double* const x = substituted_.data();
  if (f.eliminated) {
    const ChainFront& after = front(id + 1);
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
    change = std::max(change, std::abs(x[i] - f.delta[i]) / options_.relinearise_state[i]);
    f.delta[i] = x[i];
  }
  f.delta_version = f.eliminated ? f.conditional_version : f.point_version;
  if (f.bias_leaves && f.eliminated) {
    std::copy_n(x + kState, 6, BiasOf(window, keyframe.bias));
  }
  StoreState(&f, window);
  return change;
}

void IncrementalWindowSolver::BackSubstitute(Window* window, bool everything) {
  const std::int64_t oldest = fronts_.front().id, newest = fronts_.back().id;
  const int n = past_.columns().n;
  bool moved = everything;
  for (int i = 0; i < n; ++i) {
    const auto k = static_cast<size_t>(BorderColumns::kParameters + i);
    moved = moved || std::abs(shared_[k] - propagated_[k]) > options_.wildfire * sigma_[i];
  }
  for (int i = 0; i < BorderColumns::kParameters; ++i) {
    const auto k = static_cast<size_t>(i);
    moved = moved || std::abs(shared_[k] - propagated_[k]) > options_.wildfire * kBiasThreshold;
  }
  if (moved && pass_ < 0) {
    propagated_ = shared_;
    pass_ = newest;
  }
  // What the newest measurements change, as far as it reaches.
  const std::int64_t recent = OldestRecent();
  std::int64_t id = newest;
  int left = everything ? static_cast<int>(fronts_.size()) : options_.back_substituted_keyframes;
  for (; id >= oldest; --id) {
    const double change = BackSubstitute(id, window);
    if (id < recent && id > oldest && !sweep_.active && HasMoved(*window, front(id)))
      sweep_.wanted = true;
    if (--left <= 0 || (id <= recent && change < options_.wildfire)) break;
  }
  // What shared variables change, over the whole window.
  if (pass_ >= id) pass_ = id - 1;
  if (everything) {
    for (; pass_ >= oldest; --pass_) BackSubstitute(pass_, window);
  }
  for (; pass_ >= oldest && left > 0; --pass_, --left) BackSubstitute(pass_, window);
  if (pass_ < oldest) pass_ = -1;
}

bool IncrementalWindowSolver::ParametersMoved(const Window& window, const ParameterVector& from,
                                              double sigmas, double share) const {
  for (int i = 0; i < past_.columns().n; ++i) {
    const double moved = std::abs(window.eta()[i] - from[i]);
    if (moved > sigmas * sigma_[i]) return true;
    if (window.layout().is_log(i) && moved > share) return true;
  }
  return false;
}

/// Brings the chain up to the window's newest keyframe.
bool IncrementalWindowSolver::CatchUp(Window* window) {
  if (!Follows(*window)) return Build(window);
  const std::int64_t oldest = window->keyframes().front().id;
  const std::int64_t newest = window->keyframes().back().id;
  if (fronts_.empty()) {  // a new chain, on what was learned before
    for (std::int64_t id = oldest; id <= newest; ++id) AppendFront(*window, id);
    window->TakeTouched();
    return SweepAll(window);
  }
  bool sound = RedoMovedRecent(window);
  while (fronts_.back().id < newest) {
    const std::int64_t id = fronts_.back().id;
    AppendFront(*window, id + 1);
    sound = Advance(*window, id) && sound;
  }
  return sound;
}

SolveReport IncrementalWindowSolver::Solve(Window* window, const SolverOptions& options) {
  const auto start = std::chrono::steady_clock::now();
  const auto elapsed_s = [&start] {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  };
  report_ = SolveReport();
  sweep_.has_reweighed = false;
  if (options.align || window->keyframes().empty()) return Align(window, options);
  ApplyPending();
  MoveParameterPoint(*window);
  const bool followed = Follows(*window);
  const ParameterVector eta = window->eta();
  bool sound = CatchUp(window);
  if (sound && sweep_.active) {
    const int faster = MayCost(kAllowedError, *window) ? kFaster : sweep_.reweighs ? 2 : 1;
    sound = Sweep(window, faster * SweepSize());
  }
  report_.iterations = 1;
  const auto refuse = [&] {
    window->eta() = eta;
    window->MoveAnchor();
    FinishReweighing(window);
    if (followed) WritePrior(past_, window);
    Forget();
    report_.message = "a factor cannot be evaluated at the present estimate";
    return report_;
  };
  if (!sound) return refuse();
  const auto in_time = [&] { return elapsed_s() < options.max_time_s; };
  if (!SolveRoot(window) || !Correct(window, in_time)) return Align(window, options);
  BackSubstitute(window, false);
  // The newest states come in where odometry has them and move most.
  for (int pass = 0; pass < options_.recent_passes; ++pass) {
    const int before = report_.eliminated;
    if (!RedoMovedRecent(window)) return refuse();
    if (report_.eliminated == before) break;
    if (!SolveRoot(window)) return Align(window, options);
    BackSubstitute(window, false);
  }
  const bool had_reweighed = sweep_.has_reweighed;
  // Where old linearizations may cost too much, one sweep after the other, as far as time allows.
  bool has_hurried = false, has_reweighed = had_reweighed;
  const bool may_hurry = sweep_.urgent || fronts_.size() <= kMostHurried;
  for (int i = 0; may_hurry && MayCost(kIntolerable, *window) && in_time(); ++i) {
    if (i == kMostHurriedSweeps) return Align(window, options);  // steps want damping
    if (!sweep_.active) StartSweep(*window);
    while (sound && sweep_.active && in_time()) {
      sound = Sweep(window, SweepSize(), false);
    }
    has_hurried = true;
    has_reweighed = has_reweighed || sweep_.has_reweighed;
    if (!sound) return refuse();
    if (!SolveRoot(window)) return Align(window, options);
    BackSubstitute(window, false);
  }
  if (had_reweighed ? has_hurried : has_reweighed) {
    BackSubstitute(window, fronts_.size() <= kMostHurried);  // weights move states
    const bool is_short = fronts_.size() <= kMostHurried;
    if (!Correct(window, in_time, is_short)) return Align(window, options);
    BackSubstitute(window, false);
  }
  for (; report_.iterations < options.max_iterations; ++report_.iterations) {
    if (!in_time()) break;
    BackSubstitute(window, true);
    const bool moved =
        ParametersMoved(*window, sweep_.begun_at, kSettled, options_.relinearise_share);
    if (!moved && MovePoints(*window, fronts_.front().id + 1) < 0) break;
    if (!SweepAll(window)) return refuse();
    if (!SolveRoot(window)) return Align(window, options);
  }
  report_.usable = report_.improved = true;
  const double far = std::max(options_.relinearise_parameters, DistanceAt(kWorthwhile, curvature_));
  if (!sweep_.active && (sweep_.wanted || ParametersMoved(*window, sweep_.begun_at, far,
                                                          options_.relinearise_share))) {
    StartSweep(*window);
  }
  report_.sweeping = sweep_.active;
  report_.reweighing = sweep_.reweighs;
  report_.converged = !sweep_.active;
  return report_;
}

// ---- What left, and what is known ---------------------------------------------------------------

/// What a leaving keyframe's factors say at the present estimate, by their linearizations.
void IncrementalWindowSolver::Observe(const Window& window, const ChainFront& f,
                                      LeavingFactors* leaving) const {
  const int n = past_.columns().n;
  leaving->score.setZero(n);
  leaving->force_information.setZero(n);
  leaving->torque_information.setZero(n);
  const Keyframe& keyframe = window.keyframe(f.id);
  std::array<double, kState> own, next{};
  f.Offset(window, own.data());
  const bool has_next = fronts_.size() > 1;
  if (has_next) fronts_[1].Offset(window, next.data());
  for (size_t k = 0; k < f.kept().size(); ++k) {
    const Factor& factor = keyframe.factors[k];
    const ChainFront::KeptFactor& kept = f.kept()[k];
    if (!factor.parameters || !kept.sound || (kept.in_pair && !has_next)) continue;
    const RowBlock& block = kept.in_pair ? f.pair : f.own;
    const int parameters = (kept.in_pair ? f.border() : kState) + BorderColumns::kParameters;
    std::array<double, kMostFactorRows> residual;
    f.LinearResidual(window, factor, kept, own.data(), next.data(), residual.data());
    int torque_rows = 0;
    if (factor.kind == FactorKind::kDynamics) {
      const auto* dynamics = dynamic_cast<const DynamicsFactor*>(factor.cost.get());
      torque_rows = dynamics != nullptr && dynamics->with_torque() ? 3 : 0;
    }
    const double* corrected = f.corrected.row(static_cast<int>(k));
    leaving->score +=
        Eigen::Map<const Eigen::VectorXd>(corrected + f.border() + BorderColumns::kParameters, n);
    for (int i = 0; i < kept.rows; ++i) {
      const Eigen::Map<const Eigen::VectorXd> J(block.row(kept.row + i) + parameters, n);
      leaving->score += residual[static_cast<size_t>(i)] * J;
      if (factor.kind != FactorKind::kDynamics) continue;
      (i < kept.rows - torque_rows ? leaving->force_information : leaving->torque_information) +=
          J.cwiseAbs2();
    }
  }
}

bool IncrementalWindowSolver::MarginalizeOldest(Window* window, const Eigen::VectorXd& relinearize,
                                                LeavingFactors* leaving) {
  if (!Follows(*window)) return batch_.MarginalizeOldest(window, relinearize, leaving);
  bool sound = true;
  if (fronts_.size() < window->keyframes().size()) sound = CatchUp(window);
  if (sweep_.reweighs) sound = Sweep(window, static_cast<int>(fronts_.size()) + 1) && sound;
  // The sweep stays ahead of what leaves.
  while (sweep_.active && sweep_.next == fronts_.front().id && fronts_.size() > 1) {
    sound = Sweep(window, 1) && sound;
  }
  if (fronts_.front().waits && fronts_.size() > 1 && !checkpoints_.empty()) {
    std::fill(found_.begin(), found_.end(), 0.0);
    fronts_.front().PassOn(&fronts_[1], &scratch_, found_.data());
    GiveFoundToRoots(*window, fronts_[1].id);
  }
  const ChainFront& oldest = fronts_.front();
  if (leaving != nullptr) Observe(*window, oldest, leaving);
  oldest.LeaveTo(&past_, &scratch_);
  const bool last = fronts_.size() == 1;
  const bool has_bias = window->keyframes().front().bias >= 0;
  if (last) {
    past_.DropBias();
    have_root_ = false;
    checkpoints_.clear();
    sweep_.active = sweep_.wanted = sweep_.urgent = sweep_.reweighs = false;
    curvature_ = kFirstCurvature;
  }
  if (has_bias && (last || oldest.bias_leaves)) window->biases().pop_front();
  window->DropOldestKeyframe();
  fronts_.pop_front();
  if (fronts_.empty()) {
    segments_.clear();
  } else if (segments_.front().first + options_.segment_keyframes <= fronts_.front().id) {
    segments_.pop_front();
  }
  while (!checkpoints_.empty() && !fronts_.empty() &&
         checkpoints_.front().id < fronts_.front().id) {
    checkpoints_.pop_front();
  }
  return sound;
}

bool IncrementalWindowSolver::ParameterCovariance(const Window& window,
                                                  const Eigen::VectorXd& sigma,
                                                  Eigen::MatrixXd* covariance) {
  if (!Follows(window)) {
    const bool known = batch_.ParameterCovariance(window, sigma, covariance);
    if (known) sigma_ = covariance->diagonal().cwiseSqrt();
    return known;
  }
  ApplyPending();
  if (fronts_.empty()) {
    root_ = past_;
    root_.AbsorbPriors(window.parameter_centre(), window.parameter_sigma());
  }
  if (!root_.Covariance(covariance)) return false;  // finite, so is its diagonal's root
  for (int i = 0; i < past_.columns().n; ++i) sigma_[i] = std::sqrt((*covariance)(i, i));
  return true;
}

bool IncrementalWindowSolver::StateCovariance(const Window& window, StateMatrix* covariance) {
  if (!Follows(window) || fronts_.empty()) return batch_.StateCovariance(window, covariance);
  // Rows [T S] of the state and R of the root: covariance T^-1 (I + Q Qᵀ) T^-ᵀ with Q R = S.
  const int shared = past_.columns().pivots();
  StateMatrix sum = StateMatrix::Identity();
  scratch_.pair.SetZero(kState, PaddedRow(shared));
  for (int i = 0; i < kState; ++i) {
    if (std::abs(triangle_.row(i)[i]) < kLeastPivot) return false;
    double* q = scratch_.pair.row(i);
    std::copy_n(triangle_.row(i) + kState, shared, q);
    for (int j = 0; j < shared; ++j) {
      const double* r = root_.row(j);
      if (std::abs(r[j]) < kLeastPivot) {
        if (std::abs(q[j]) > kLeastPivot) return false;
        continue;
      }
      q[j] /= r[j];
      for (int k = j + 1; k < shared; ++k) q[k] -= q[j] * r[k];
    }
    for (int k = 0; k <= i; ++k) {
      const double* other = scratch_.pair.row(k);
      double dot = 0.0;
      for (int j = 0; j < shared; ++j) dot += q[j] * other[j];
      sum(i, k) += dot;
      if (k < i) sum(k, i) += dot;
    }
  }
  StateMatrix T = StateMatrix::Zero();
  for (int i = 0; i < kState; ++i) {
    for (int j = i; j < kState; ++j) T(i, j) = triangle_.row(i)[j];
  }
  T.triangularView<Eigen::Upper>().solveInPlace(sum);
  *covariance = sum.transpose();
  T.triangularView<Eigen::Upper>().solveInPlace(*covariance);
  return covariance->allFinite();
}

/// Changes what is past; the roots take notice before they are used next.
template <typename Change>
void IncrementalWindowSolver::ChangePast(const Change& change) {
  past_.ParameterNormal(&workspace_, &normal_);
  pending_ -= normal_;
  change();
  past_.ParameterNormal(&workspace_, &normal_);
  pending_ += normal_;
  has_pending_ = true;
}

/// What changed in the past changes all roots that hold it by the same sum of squares: rows about
/// parameters alone simply add up.
void IncrementalWindowSolver::ApplyPending() {
  if (!has_pending_) return;
  has_pending_ = false;
  bool positive = root_.AddNormal(pending_, &workspace_);
  for (Checkpoint& checkpoint : checkpoints_) {
    positive = checkpoint.root.AddNormal(pending_, &workspace_) && positive;
  }
  if (sweep_.active) positive = sweep_.root.AddNormal(pending_, &workspace_) && positive;
  pending_.setZero();
  if (!positive) sweep_.wanted = true;  // rounding: the sweep starts from the past itself
}

const Eigen::MatrixXd& IncrementalWindowSolver::Reweigh(
    const Eigen::Ref<const Eigen::VectorXd>& scale, std::function<void(Keyframe*)> weigh,
    Window* window) {
  if (!Follows(*window)) return batch_.Reweigh(scale, std::move(weigh), window);
  // The chain in use keeps the old weights, all of them, until a sweep is through.
  sweep_.past = past_;
  past_.ScaleParameters(scale, &workspace_, &scale_root_);
  if (!fronts_.empty()) {
    StartSweep(*window);
    sweep_.reweighs = true;
    sweep_.weigh = std::move(weigh);
  }
  return scale_root_;
}

const Eigen::MatrixXd& IncrementalWindowSolver::ScalePast(
    const Eigen::Ref<const Eigen::VectorXd>& scale, Window* window) {
  if (!Follows(*window)) return batch_.ScalePast(scale, window);
  ChangePast([&] { past_.ScaleParameters(scale, &workspace_, &scale_root_); });
  return scale_root_;
}

void IncrementalWindowSolver::LetPastVary(int index, const ProcessStep& step, Window* window) {
  HandBack(window);
  batch_.LetPastVary(index, step, window);
}

void IncrementalWindowSolver::LetPastWalk(const Eigen::Ref<const Eigen::VectorXd>& direction,
                                          double variance, Window* window) {
  if (!Follows(*window)) return batch_.LetPastWalk(direction, variance, window);
  ChangePast([&] { past_.LetWalk(direction, variance, &workspace_); });
}

const Eigen::MatrixXd& IncrementalWindowSolver::PastInformation(const Window& window) {
  if (!Follows(window)) return batch_.PastInformation(window);
  const int n = past_.columns().n;
  past_.ParameterNormal(&workspace_, &normal_);
  past_information_ = normal_.leftCols(n);
  return past_information_;
}

}  // namespace odmc
