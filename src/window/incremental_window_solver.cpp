#include "odmc/window/incremental_window_solver.h"

#include <algorithm>
#include <chrono>
#include <utility>

#include "odmc/window/chain_prior.h"

namespace odmc {
namespace {

constexpr double kAllowedError = 0.5;  // of a tolerance, before it hurries
constexpr double kIntolerable = 0.8;   // before it takes all the time there is
constexpr double kSettled = 0.05;      // where further iterations were asked for [sigmas]
constexpr size_t kSoonInTurn = 5;      // updates: short windows need no more than their turn
constexpr double kWeightMoved = 1.1;   // of a recent factor: root of the robust loss' slope
constexpr double kLeastHopeForCorrection = 0.3;  // to be corrected [sigmas]
constexpr int kFaster = 4;                       // sweep where errors are not allowed
constexpr int kFasterInShort = 3;      // windows: it is through within a few updates all the same
constexpr size_t kMostHurried = 350;   // keyframes; in longer windows parameters move less
constexpr int kMostHurriedSweeps = 4;  // in one update
constexpr double kAlignmentTolerance = 1e-4;  // of its cost; the chain takes the last step
constexpr int kAlignmentIterations = 10;
constexpr int kLeastAlignmentIterations = 2;  // that must fit into an update
constexpr int kMostFollowUps = 3;             // sweeps after one that aligns
// Per keyframe, in units of an elimination of it, by the time they take.
constexpr int kAlignmentIteration = 2;
constexpr int kCorrectionsAWork = 2, kBackSubstitutionsAWork = 20;

}  // namespace

/// How much a solve may do, and how long it may take.
class IncrementalWindowSolver::Allowance {
 public:
  Allowance(const SolverOptions& options, const IncrementalWindowSolver* solver)
      : max_time_s_(options.max_time_s), max_work_(options.max_work), solver_(solver) {}
  bool IsLeft() const {
    return solver_->Work() < max_work_ &&
           std::chrono::duration<double>(Clock::now() - start_).count() < max_time_s_;
  }

 private:
  using Clock = std::chrono::steady_clock;
  const Clock::time_point start_ = Clock::now();
  const double max_time_s_;
  const int max_work_;
  const IncrementalWindowSolver* const solver_;
};

IncrementalWindowSolver::IncrementalWindowSolver(const IncrementalOptions& options)
    : options_(options),
      chain_(&options_),
      error_(&options_),
      corrections_(&options_, &chain_, &sweep_, &error_),
      solution_(&options_, &chain_, &error_),
      alignment_(&chain_, &solution_) {}
IncrementalWindowSolver::~IncrementalWindowSolver() = default;

// ---- Between the window's prior and the chain ---------------------------------------------------

/// True if the fronts are those of the window's oldest keyframes.
bool IncrementalWindowSolver::Follows(const Window& window) const {
  if (!incremental_ || past_.num_parameters() != window.layout().num_estimated()) return false;
  const Ring<ChainFront>& fronts = chain_.fronts;
  if (fronts.empty()) return true;
  return !window.keyframes().empty() && fronts.front().id == window.keyframes().front().id &&
         fronts.size() <= window.keyframes().size();
}

void IncrementalWindowSolver::Forget() {
  incremental_ = false;
  have_root_ = false;
  chain_.Clear();
  sweep_.Forget();
  corrections_.Clear();
  error_.ForgetCurvature();
  solution_.ForgetPass();
}

void IncrementalWindowSolver::WritePrior(Window* window) {
  if (incremental_) WritePrior(sweep_.reweighs ? sweep_.past : past_.rows(), window);
}

void IncrementalWindowSolver::WritePrior(const RootTriangle& past, Window* window) const {
  if (options_.keeps_prior) return;  // it is what it was
  WriteChainPrior(past, chain_.fronts.empty() ? nullptr : &chain_.fronts.front(), window);
}

/// Takes the window over as it stands, the past from its prior; nothing is eliminated yet.
void IncrementalWindowSolver::Read(const Window& window) {
  ReadChain(window, &chain_, &past_);
  for (const ChainFront& front : chain_.fronts) corrections_.Append(window, front.id);
  solution_.Reset(window, past_.rows().stride());
  corrections_.Reset(past_.columns().pivots());
}

/// Makes the chain from the window as it stands.
bool IncrementalWindowSolver::Build(Window* window) {
  Forget();
  Read(*window);
  incremental_ = true;
  window->TakeTouched();
  window->MoveAnchor();
  if (error_.sigma.size() != past_.num_parameters()) error_.sigma = window->parameter_sigma();
  error_.SetInUse(window->eta());
  if (chain_.fronts.empty()) {
    RootOfPastAlone(*window);
    sweep_.begun_at = window->eta();
    return true;
  }
  chain_.fronts.front().MovePointWithMessage(*window, &chain_.scratch);
  return SweepAll(window);
}

void IncrementalWindowSolver::RootOfPastAlone(const Window& window) {
  chain_.root = past_.rows();
  chain_.root.AbsorbPriors(window.parameter_centre(), window.parameter_sigma());
}

/// Puts the past back into the window.
void IncrementalWindowSolver::HandBack(Window* window) {
  TellRootsOfPast();
  sweep_.FinishReweighing(window);
  if (Follows(*window)) WritePrior(past_.rows(), window);
  Forget();
}

/// Solves the window as a whole and builds the chain where that ends.
SolveReport IncrementalWindowSolver::SolveWhole(Window* window, const SolverOptions& options) {
  HandBack(window);
  SolveReport report;
  report.usable = report.converged = window->keyframes().empty();
  if (report.usable) return report;
  Read(*window);
  report = alignment_.Solve(past_.rows(), options, window);
  if (!report.usable) {
    Forget();
  } else if (!Build(window)) {
    HandBack(window);
  }
  return report;
}

SolveReport IncrementalWindowSolver::Align(Window* window, const SolverOptions& options) {
  // Asked for, it solves the same problem better; factors that were touched, or a step too long for
  // a linear model, make another problem of it.
  const bool is_same = options.align && window->TakeTouched() < 0;
  const double curvature = error_.curvature();
  SolverOptions thorough = options;
  thorough.max_iterations = std::max(options.max_iterations, kAlignmentIterations);
  const int states = std::max(1, static_cast<int>(window->keyframes().size()));
  const int fitting = (options.max_work / states - 1) / kAlignmentIteration;
  thorough.max_iterations = std::clamp(fitting, 1, thorough.max_iterations);
  // From there the chain takes the last step.
  thorough.function_tolerance = std::max(options.function_tolerance, kAlignmentTolerance);
  SolveReport report = SolveWhole(window, thorough);
  report.aligned = true;
  if (chain_.fronts.empty() || !Follows(*window)) return report;
  if (is_same) error_.SetCurvature(curvature);
  if (SolveRoot(window)) BackSubstitute(window, true);
  report.work += Work();
  return report;
}

/// True if an alignment of the window is little enough work for one update.
bool IncrementalWindowSolver::AlignmentFits(const Window& window) const {
  constexpr int kWork = kAlignmentIteration * kLeastAlignmentIterations + 1;
  return static_cast<int>(window.keyframes().size()) <= max_work_ / kWork;
}

/// What the alignment of a longer window is: sweeps, as many an update as it may work, until the
/// parameters have settled.
void IncrementalWindowSolver::AskForAlignment(const Window& window) {
  if (!sweep_.active) StartSweep(window);
  sweep_.urgent = true;
  follow_ups_left_ = kMostFollowUps;
}

/// What was done since the last solve, SolveReport::work.
int IncrementalWindowSolver::Work() const {
  return chain_.eliminated + corrections_.corrected / kCorrectionsAWork +
         solution_.back_substituted / kBackSubstitutionsAWork;
}

// ---- The chain ----------------------------------------------------------------------------------

void IncrementalWindowSolver::AppendFront(const Window& window, std::int64_t id) {
  chain_.fronts.Append().Reset(window, id);
  corrections_.Append(window, id);
}

/// Linearizes newest states that have moved anew, and what was touched.
bool IncrementalWindowSolver::RedoMovedRecent(Window* window) {
  const std::int64_t newest = chain_.newest();
  const std::int64_t oldest = std::max(chain_.OldestRecent(), chain_.checkpoints.front().id);
  std::int64_t from = newest + 1;
  const std::int64_t touched = window->TakeTouched();
  if (touched >= 0) {
    if (touched < oldest) {  // a sweep under way may have passed it
      error_.ExpectNoLess();
      StartSweep(*window);
      sweep_.urgent = true;
    }
    from = std::max(touched, oldest);
  }
  // With the factors to the state before.
  const std::int64_t moved = chain_.MovePoints(*window, oldest + 1);
  if (moved >= 0) from = std::min(from, moved - 1);
  for (std::int64_t id = oldest; id < std::min(from, newest); ++id) {
    if (!chain_.front(id).FollowWeights(*window, chain_.front(id + 1), kWeightMoved)) continue;
    from = id;
    break;
  }
  if (error_.Distance(*window, recent_at_) > options_.relinearise_recent) {
    from = std::min(from, oldest);
  }
  if (from > newest) return true;
  if (from <= oldest) recent_at_ = window->eta();
  return chain_.Redo(*window, from);
}

/// Brings the chain up to the window's newest keyframe.
bool IncrementalWindowSolver::CatchUp(Window* window) {
  if (!Follows(*window)) return Build(window);
  const std::int64_t oldest = window->keyframes().front().id;
  const std::int64_t newest = window->keyframes().back().id;
  if (chain_.fronts.empty()) {  // a new chain, on what was learned before
    for (std::int64_t id = oldest; id <= newest; ++id) AppendFront(*window, id);
    window->TakeTouched();
    return SweepAll(window);
  }
  bool sound = RedoMovedRecent(window);
  while (chain_.newest() < newest) {
    const std::int64_t id = chain_.newest();
    AppendFront(*window, id + 1);
    sound = chain_.Advance(*window, id) && sound;
  }
  return sound;
}

/// Brings parameters' point of linearization to the present estimate.
void IncrementalWindowSolver::MoveParameterPoint(const Window& window) {
  const ParameterVector& eta = window.eta();
  if (chain_.point.size() == eta.size() &&
      !error_.HaveMoved(window, chain_.point, options_.same_point, options_.same_point)) {
    return;
  }
  chain_.MoveParameterPoint(eta);
}

// ---- The sweep ----------------------------------------------------------------------------------

void IncrementalWindowSolver::StartSweep(const Window& window) {
  TellRootsOfPast();
  sweep_.Start(past_.rows(), chain_.oldest(), window);
}

int IncrementalWindowSolver::SweepSize() const {
  const auto share =
      static_cast<int>(options_.sweep_share * static_cast<double>(chain_.fronts.size()));
  return std::max(options_.sweep_keyframes, share);
}

/// @param corrects the fronts it takes; else the chain in use should soon be done with
bool IncrementalWindowSolver::Sweep(Window* window, int budget, bool corrects) {
  const std::int64_t end = sweep_.next + budget;
  const bool is_last = end >= chain_.OldestRecent();
  if (corrects && sweep_.active && have_root_ && !chain_.checkpoints.empty() && !is_last &&
      !sweep_.urgent) {
    corrections_.CorrectBeforeSweep(*window, end);
  }
  bool sound = true;
  MoveParameterPoint(*window);
  for (int i = 0; i < budget && sweep_.active; ++i) {
    if (sweep_.next < chain_.OldestRecent()) {
      sound = sweep_.EliminateNext(&chain_, window) && sound;
      corrections_.NoteSwept(sweep_.next);
    }
    if (sweep_.next >= chain_.OldestRecent()) sound = TakeOver(window) && sound;
  }
  return sound;
}

/// The sweep has caught up: the rest at once, from here on it is the chain in use.
bool IncrementalWindowSolver::TakeOver(Window* window) {
  sweep_.FinishReweighing(window);
  const bool known =
      have_root_ && !sweep_.urgent && !sweep_.reweighs && error_.SeeBefore(chain_.root);
  sweep_.has_reweighed = sweep_.reweighs;
  is_to_settle_ = sweep_.urgent && follow_ups_left_ > 0;
  sweep_.active = sweep_.urgent = sweep_.reweighs = false;
  chain_.RestartFrom(sweep_.next, sweep_.root);
  chain_.MovePoints(*window, sweep_.next + 1);
  recent_at_ = window->eta();
  const bool sound = chain_.Redo(*window, sweep_.next);
  have_root_ = true;
  if (known) error_.LearnFrom(chain_.root, sweep_.begun_at);
  error_.SetInUse(sweep_.begun_at);
  solution_.Release();
  return sound;
}

bool IncrementalWindowSolver::SweepAll(Window* window) {
  StartSweep(*window);
  return Sweep(window, static_cast<int>(chain_.fronts.size()) + 1);
}

bool IncrementalWindowSolver::IsShort() const { return chain_.fronts.size() <= kMostHurried; }

/// True if putting the relinearization off might cost more than `error` tolerances.
bool IncrementalWindowSolver::MayCost(double error, const Window& window) const {
  return sweep_.urgent || error_.MayCost(error, window);
}

// ---- One update ---------------------------------------------------------------------------------

/// True if what was corrected before the sweep took it is about as much as a turn: a fast sweep
/// goes through all within a few updates.
bool IncrementalWindowSolver::SweepHadTurn() const {
  return 2 * corrections_.corrected > options_.corrected_segments * options_.segment_keyframes;
}

/// Corrects one portion in turn, unless a fast sweep has, and then the segments that need it most,
/// each once at most; `all`: every one, as far as time goes.
/// @returns false if the step is too long for a linear model
bool IncrementalWindowSolver::Correct(Window* window, const Allowance& allowance, bool all) {
  if (chain_.checkpoints.empty() || options_.corrected_segments == 0) return true;
  const size_t in_turn = kSoonInTurn * static_cast<size_t>(options_.corrected_segments);
  // New weights move states; in the long windows of a flight's start segments wait long for a turn.
  all = all || (sweep_.has_reweighed && corrections_.size() > 2 * in_turn && IsShort());
  const std::int64_t before = corrections_.turn();
  const double expected_before = corrections_.ExpectErrors(*window);
  const bool had_turn = !all && !sweep_.has_reweighed && SweepHadTurn();
  if (had_turn && (expected_before < options_.allowed_lag || corrections_.size() <= in_turn)) {
    return true;
  }
  for (bool first = !had_turn;; first = false) {
    ChainSegment* chosen = nullptr;
    for (int i = 0; i < options_.corrected_segments; ++i) {
      // In turn: states move as well, and weights are followed step by step.
      chosen = corrections_.Choose(before, first);
      if (chosen == nullptr) break;
      corrections_.Correct(*window, chosen);
    }
    if (!SolveRoot(window)) return false;
    if (all && chosen != nullptr && allowance.IsLeft()) continue;
    const double expected = corrections_.ExpectErrors(*window);
    if (expected < options_.allowed_lag || chosen == nullptr || !allowance.IsLeft()) return true;
    if (corrections_.size() <= in_turn && !sweep_.has_reweighed) return true;
    if (expected > std::max(expected_before, kLeastHopeForCorrection)) {
      sweep_.urgent = true;  // by Jacobians this old it might not converge
      return true;
    }
  }
}

/// Parameters from the root. A step that is too long for a linear model is left to an alignment
/// where that fits into the update; else it is damped, and sweeps hurry on from where it ends.
/// @returns false if the step is not to be taken
bool IncrementalWindowSolver::SolveRoot(Window* window) {
  using Step = ChainSolution::Step;
  const Step step = solution_.SolveRoot(AlignmentFits(*window) ? ChainSolution::LongSteps::kRefused
                                                               : ChainSolution::LongSteps::kDamped,
                                        window);
  if (step == Step::kRefused) return false;
  if (step == Step::kDamped) {
    error_.ExpectNoLess();
    sweep_.urgent = sweep_.wanted = true;
    follow_ups_left_ = kMostFollowUps;
  } else if (is_to_settle_) {
    const bool moved =
        error_.HaveMoved(*window, sweep_.begun_at, kSettled, options_.relinearise_share);
    follow_ups_left_ = moved ? follow_ups_left_ - 1 : 0;
    if (moved) sweep_.urgent = sweep_.wanted = true;
  }
  is_to_settle_ = false;
  return true;
}

void IncrementalWindowSolver::BackSubstitute(Window* window, bool everything) {
  if (solution_.BackSubstitute(window, everything) && !sweep_.active) sweep_.wanted = true;
}

/// Takes up what is new, and the sweep's next portion.
IncrementalWindowSolver::Outcome IncrementalWindowSolver::Follow(Window* window,
                                                                 const Allowance& allowance) {
  const bool is_new = !Follows(*window);
  bool sound = CatchUp(window);
  if (sound && sweep_.active) {
    const int fast = corrections_.size() <= kSoonInTurn ? kFasterInShort : kFaster;
    const int faster = MayCost(kAllowedError, *window) ? fast : sweep_.reweighs ? 2 : 1;
    sound = Sweep(window, faster * SweepSize());
  }
  if (!sound) return Outcome::kRefused;
  if (!SolveRoot(window) || !Correct(window, allowance)) return Outcome::kTooLong;
  BackSubstitute(window, is_new);
  return Outcome::kDone;
}

/// The newest states come in where odometry has them and move most.
IncrementalWindowSolver::Outcome IncrementalWindowSolver::SettleRecent(Window* window) {
  for (int pass = 0; pass < options_.recent_passes; ++pass) {
    const int before = chain_.eliminated;
    if (!RedoMovedRecent(window)) return Outcome::kRefused;
    if (chain_.eliminated == before) break;
    if (!SolveRoot(window)) return Outcome::kTooLong;
    BackSubstitute(window, false);
  }
  return Outcome::kDone;
}

/// Goes on with the sweep, or starts one, as far as the allowance goes.
/// @returns false if a factor cannot be evaluated
bool IncrementalWindowSolver::SweepOn(Window* window, const Allowance& allowance) {
  if (!sweep_.active) StartSweep(*window);
  bool sound = true;
  while (sound && sweep_.active && allowance.IsLeft()) sound = Sweep(window, SweepSize(), false);
  return sound;
}

/// Where old linearizations may cost too much, one sweep after the other, as far as the allowance
/// goes; what a sweep weighed anew is corrected.
IncrementalWindowSolver::Outcome IncrementalWindowSolver::AdvanceSweepToBudget(
    Window* window, const Allowance& allowance) {
  const bool had_reweighed = sweep_.has_reweighed;
  bool has_hurried = false, has_reweighed = had_reweighed;
  const bool may_hurry = sweep_.urgent || IsShort();
  for (int i = 0; may_hurry && MayCost(kIntolerable, *window) && allowance.IsLeft(); ++i) {
    if (i == kMostHurriedSweeps) {
      if (AlignmentFits(*window)) return Outcome::kTooLong;  // steps want damping
      break;
    }
    const bool sound = SweepOn(window, allowance);
    has_hurried = true;
    has_reweighed = has_reweighed || sweep_.has_reweighed;
    if (!sound) return Outcome::kRefused;
    if (!SolveRoot(window)) return Outcome::kTooLong;
    BackSubstitute(window, false);
  }
  if (!(had_reweighed ? has_hurried : has_reweighed)) return Outcome::kDone;
  BackSubstitute(window, IsShort());  // weights move states
  if (!Correct(window, allowance, IsShort())) return Outcome::kTooLong;
  BackSubstitute(window, false);
  return Outcome::kDone;
}

/// Further iterations, if they were asked for: the whole window each, over as many updates as the
/// allowance makes of it.
IncrementalWindowSolver::Outcome IncrementalWindowSolver::Iterate(Window* window,
                                                                  int max_iterations,
                                                                  const Allowance& allowance) {
  for (; report_.iterations < max_iterations && allowance.IsLeft(); ++report_.iterations) {
    BackSubstitute(window, true);
    const bool moved =
        error_.HaveMoved(*window, sweep_.begun_at, kSettled, options_.relinearise_share);
    if (!moved && chain_.MovePoints(*window, chain_.oldest() + 1) < 0) break;
    if (!SweepOn(window, allowance)) return Outcome::kRefused;
    if (!SolveRoot(window)) return Outcome::kTooLong;
    if (sweep_.active) {
      sweep_.urgent = true;
      break;
    }
  }
  return Outcome::kDone;
}

/// The update is not usable: back to where it began.
void IncrementalWindowSolver::Refuse(const ParameterVector& eta, bool followed, Window* window) {
  window->eta() = eta;
  window->MoveAnchor();
  sweep_.FinishReweighing(window);
  if (followed) WritePrior(past_.rows(), window);
  Forget();
  report_.message = "a factor cannot be evaluated at the present estimate";
}

SolveReport IncrementalWindowSolver::Solve(Window* window, const SolverOptions& options) {
  SolveReport report = SolveOnce(window, options);
  // What the keyframes that leave now ask for counts as the next solve's.
  chain_.eliminated = solution_.back_substituted = corrections_.corrected = 0;
  return report;
}

SolveReport IncrementalWindowSolver::SolveOnce(Window* window, const SolverOptions& options) {
  const Allowance allowance(options, this);
  report_ = SolveReport();
  report_.iterations = 1;
  sweep_.has_reweighed = false;
  max_work_ = options.max_work;
  if (options_.keeps_prior) {
    SolveReport report = SolveWhole(window, options);
    report.work += Work();
    return report;
  }
  const bool starts = !Follows(*window) || chain_.fronts.empty();
  if (window->keyframes().empty() || (options.align && (starts || AlignmentFits(*window)))) {
    return Align(window, options);
  }
  if (options.align) AskForAlignment(*window);
  TellRootsOfPast();
  MoveParameterPoint(*window);
  const bool followed = Follows(*window);
  const ParameterVector eta = window->eta();
  Outcome outcome = Follow(window, allowance);
  if (outcome == Outcome::kDone) outcome = SettleRecent(window);
  if (outcome == Outcome::kDone && followed) outcome = AdvanceSweepToBudget(window, allowance);
  if (outcome == Outcome::kDone) outcome = Iterate(window, options.max_iterations, allowance);
  if (outcome == Outcome::kTooLong) return Align(window, options);
  if (outcome == Outcome::kRefused) {
    Refuse(eta, followed, window);
  } else {
    report_.usable = report_.improved = true;
    if (!sweep_.active && (sweep_.wanted || error_.IsWorthASweep(*window, sweep_.begun_at))) {
      StartSweep(*window);
    }
    report_.sweeping = sweep_.active;
    report_.reweighing = sweep_.reweighs;
    report_.converged = !sweep_.active;
  }
  report_.eliminated = chain_.eliminated;
  report_.back_substituted = solution_.back_substituted;
  report_.work = Work();
  return report_;
}

// ---- What left, and what is known ---------------------------------------------------------------

bool IncrementalWindowSolver::MarginalizeOldest(Window* window, const Eigen::VectorXd& relinearize,
                                                LeavingFactors* leaving) {
  if (options_.keeps_prior) {
    HandBack(window);
    return odmc::MarginalizeOldest(window, relinearize, leaving);
  }
  const Ring<ChainFront>& fronts = chain_.fronts;
  bool sound = true;
  if (!Follows(*window) || fronts.size() < window->keyframes().size()) sound = CatchUp(window);
  if (sweep_.reweighs) sound = Sweep(window, static_cast<int>(fronts.size()) + 1) && sound;
  // The sweep stays ahead of what leaves.
  while (sweep_.active && sweep_.next == chain_.oldest() && fronts.size() > 1) {
    sound = Sweep(window, 1) && sound;
  }
  if (fronts.front().waits && fronts.size() > 1 && !chain_.checkpoints.empty()) {
    corrections_.PassOnFromOldest(*window);
  }
  if (leaving != nullptr) chain_.ObserveOldest(*window, leaving);
  past_.Absorb(fronts.front(), &chain_.scratch);
  const bool last = fronts.size() == 1;
  const bool has_bias = window->keyframes().front().bias >= 0;
  if (last) {
    past_.DropBias();
    have_root_ = false;
    chain_.checkpoints.clear();
    sweep_.Forget();
    error_.ForgetCurvature();
  }
  if (has_bias && (last || fronts.front().bias_leaves)) window->biases().pop_front();
  window->DropOldestKeyframe();
  chain_.DropOldest();
  corrections_.DropOldest();
  return sound;
}

bool IncrementalWindowSolver::ParameterCovariance(const Window& window,
                                                  const Eigen::VectorXd& /*sigma*/,
                                                  Eigen::MatrixXd* covariance) {
  if (Follows(window)) {
    TellRootsOfPast();
    if (chain_.fronts.empty()) RootOfPastAlone(window);
  } else {
    EliminateForOnce(window);
  }
  if (!chain_.root.Covariance(covariance)) return false;
  error_.sigma = covariance->diagonal().cwiseSqrt();  // finite, as the covariance is
  return true;
}

/// A chain for covariances only: the next solve builds it anew all the same.
void IncrementalWindowSolver::EliminateForOnce(const Window& window) {
  Forget();
  Read(window);
  RootOfPastAlone(window);
  if (chain_.fronts.empty()) return;
  chain_.fronts.front().MovePointWithMessage(window, &chain_.scratch);
  chain_.MoveParameterPoint(window.eta());
  chain_.EliminateAll(window, chain_.root);  // what cannot be evaluated says nothing
}

bool IncrementalWindowSolver::StateCovariance(const Window&, StateMatrix* covariance) {
  return !chain_.fronts.empty() && chain_.NewestCovariance(covariance);
}

/// What changed in the past changes all roots that hold it by the same sum of squares.
void IncrementalWindowSolver::TellRootsOfPast() {
  if (!past_.has_changed()) return;
  bool positive = past_.TellChange(&chain_.root);
  for (Chain::Checkpoint& checkpoint : chain_.checkpoints) {
    positive = past_.TellChange(&checkpoint.root) && positive;
  }
  if (sweep_.active) positive = past_.TellChange(&sweep_.root) && positive;
  past_.ForgetChange();
  if (!positive) sweep_.wanted = true;  // rounding: the sweep starts from the past itself
}

const Eigen::MatrixXd& IncrementalWindowSolver::Reweigh(
    const Eigen::Ref<const Eigen::VectorXd>& scale, std::function<void(Keyframe*)> weigh,
    Window* window) {
  if (options_.keeps_prior) HandBack(window);
  if (!Follows(*window)) {
    for (Keyframe& keyframe : window->keyframes()) weigh(&keyframe);
    return ScalePast(scale, window);
  }
  // The chain in use keeps the old weights, all of them, until a sweep is through.
  sweep_.past = past_.rows();
  const Eigen::MatrixXd& root = past_.ScaleUntold(scale);
  if (!chain_.fronts.empty()) {
    StartSweep(*window);
    sweep_.Reweigh(std::move(weigh));
  }
  return root;
}

const Eigen::MatrixXd& IncrementalWindowSolver::ScalePast(
    const Eigen::Ref<const Eigen::VectorXd>& scale, Window* window) {
  if (options_.keeps_prior) HandBack(window);
  if (Follows(*window)) return past_.Scale(scale);
  scale_root_ = RescalePrior(scale, window);
  return scale_root_;
}

void IncrementalWindowSolver::LetPastVary(int index, const ProcessStep& step, Window* window) {
  HandBack(window);
  LetPriorVary(index, step, &window->prior());
}

void IncrementalWindowSolver::LetPastWalk(const Eigen::Ref<const Eigen::VectorXd>& direction,
                                          double variance, Window* window) {
  if (options_.keeps_prior) HandBack(window);
  if (Follows(*window)) {
    past_.LetWalk(direction, variance);
  } else {
    LetPriorWalk(direction, variance, window);
  }
}

const Eigen::MatrixXd& IncrementalWindowSolver::PastInformation(const Window& window) {
  if (!Follows(window)) {
    Forget();
    Read(window);
  }
  return past_.Information();
}

}  // namespace odmc
