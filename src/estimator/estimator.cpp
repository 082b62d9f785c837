#include "odmc/estimator/estimator.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "odmc/window/ceres_window_solver.h"
#include "odmc/window/incremental_window_solver.h"
#include "update_timer.h"

namespace odmc {
namespace {

constexpr int kMostLeaving = 20;     // keyframes an update after learning
constexpr double kSettled_s = 1.0;   // age at which an interval's residual is looked at
constexpr double kMostHeld_s = 2.0;  // that the window grows while contact is suspected
constexpr double kMostRoom = 1e5;    // keyframes
constexpr double kWaiting = 1.1;     // of the window, at most, while it is weighed anew

/// Newest keyframes whose factors change after they were added: averages of rotor accelerations
/// take in later intervals (RotorRateSmoother).
int FreshKeyframes(const DynamicModel& model, const EstimatorOptions& options) {
  if (!model.takes_rotor_rates()) return 0;
  return static_cast<int>(std::ceil(0.5 * kRotorRatesWindow_s * options.keyframe_rate_hz));
}

/// In the window of a flight without contact, with those that wait for new weights; 0 for options
/// that are refused anyway.
int MostKeyframes(const EstimatorOptions& options) {
  const double longest_s = std::max(options.window_s, LearningSchedule::kLearning_s);
  const double keyframes =
      std::ceil(kWaiting * longest_s * options.keyframe_rate_hz) + kMostLeaving;
  return keyframes > 0.0 && keyframes < kMostRoom ? static_cast<int>(keyframes) : 0;
}

std::unique_ptr<WindowSolver> MakeSolver(const EstimatorOptions& options,
                                         const DynamicModel& model) {
  const int fresh = FreshKeyframes(model, options);
  if (options.solver == "ceres") return std::make_unique<CeresWindowSolver>(3 + fresh);
  IncrementalOptions incremental;
  incremental.room_for_keyframes = MostKeyframes(options);
  incremental.recent_keyframes += fresh;
  incremental.keeps_prior = !model.processes().empty();
  // Form E ties positions to the force twice integrated, a hundred times tighter than odometry.
  if (options.dynamics_form == "euler") {
    for (double& threshold : incremental.relinearise_state) threshold *= 0.05;
  }
  return std::make_unique<IncrementalWindowSolver>(incremental);
}

ModelNoise MakeModelNoise(const EstimatorOptions& options, const Vehicle& vehicle,
                          bool with_torque) {
  return {vehicle, options.process_noise_floor, options.accelerometer_noise_m_s2, options.window_s,
          with_torque};
}

/// Entries of eta that are to walk with the flight.
std::vector<int> Walking(const EstimatorOptions& options, const DynamicModel& model,
                         const ParameterLayout& layout) {
  std::vector<int> entries;
  if (options.k_f_walk_rate == 0.0) return entries;
  for (const char* name : {"thrust.k_f", "rotor_torque.k_m"}) {
    const int k = model.IndexOf(name);
    if (k >= 0 && layout.EntryOf(k) >= 0) entries.push_back(layout.EntryOf(k));
  }
  return entries;
}

}  // namespace

Estimator::Estimator(const DynamicModel* model, const EstimatorOptions& options, bool with_torque)
    : model_(model),
      options_(options),
      layout_(*model, model->InitialValues()),
      front_end_(model, &options_),
      window_(&layout_),
      solver_(MakeSolver(options, *model)),
      schedule_(model, &options_, with_torque),
      model_noise_(MakeModelNoise(options, model->vehicle(), with_torque)),
      factors_(model, &options_, with_torque, &layout_, &window_),
      changes_(model->vehicle()),
      uncertainty_(model, &layout_) {
  std::string error;
  if (!options.IsValid(&error)) throw std::invalid_argument(error);
  window_.keyframes().Reserve(static_cast<size_t>(MostKeyframes(options)));
  const int k_f = model->IndexOf("thrust.k_f");
  if (with_torque && k_f >= 0) window_.SetAnchorEntry(layout_.EntryOf(k_f));
  uncertainty_.SetWalking(Walking(options, *model, layout_), options.k_f_walk_rate);
}

Estimator::~Estimator() = default;

const Snapshot* Estimator::Step() {
  UpdateTimer timer;
  const std::optional<OdometrySample> sample = front_end_.NextKeyframe();
  made_progress_ = sample.has_value();
  if (!sample) return nullptr;
  const PhaseVerdict verdict = FollowPhase(*sample);
  front_end_.FollowLoad(*sample, window_);
  const Snapshot* snapshot = nullptr;
  if (!Teaches(verdict.phase)) {
    ++counters_.ground_keyframes;
    BreakChain();
    if (verdict.take_back) snapshot = TakeBack(*verdict.take_back);
  } else if (front_end_.IsLeftOut(*sample)) {
    BreakChain();
  } else {
    snapshot = Update(*sample, &timer);
  }
  front_end_.Keep(*sample);
  return snapshot;
}

const Snapshot* Estimator::Update(const OdometrySample& sample, UpdateTimer* timer) {
  UpdateTiming timing;
  const std::optional<KeyframeInterval> interval = ReadInterval(sample);
  timing.read_ms = timer->EndStageMs();

  ++counters_.keyframes;
  if (!interval) ++counters_.chains;
  factors_.AddKeyframe(sample, interval, front_end_, model_noise_, counters_.keyframes, &schedule_);
  front_end_.ContinueChain();
  const SolverOptions solve = schedule_.ForUpdate(counters_.airborne_s, &window_);
  timing.build_ms = timer->EndStageMs();

  const SolveReport report = solver_->Solve(&window_, solve);
  timing.solve_ms = timer->EndStageMs();
  if (!report.usable) ++counters_.refused_updates;
  schedule_.Solved(solve, report, window_);

  TakeSnapshot(sample.stamp, report);
  timing.snapshot_ms = timer->EndStageMs();
  if (observe_) {
    timer->RunUntimed([this] {
      observe_({*model_, snapshot_.solve, uncertainty_.sigma_eta(), model_noise_, &window_,
                solver_.get()});
    });
  }

  Describe(report, &timing);
  model_noise_.Follow(window_,
                      std::min(options_.window_s, kSettled_s) - 1.5 / options_.keyframe_rate_hz);
  if (!report.reweighing) {  // what leaves has one weight
    MarginalizeOld();
    RescaleNoise();
  }
  if (options_.detect_changes && changes_.Look(window_)) LearnAnew();
  timing.marginalize_ms = timer->EndStageMs();
  timing.wall_ms = timer->WallMs();
  timing.cpu_ms = timer->CpuMs();
  snapshot_.timing = timing;
  TellPhases(sample.stamp);
  return &snapshot_;
}

/// Asks what phase the flight is in, and does what follows from it for what was learned.
PhaseVerdict Estimator::FollowPhase(const OdometrySample& sample) {
  const PhaseVerdict verdict = front_end_.FollowPhase(sample);
  if (verdict.start_anew) StartAnew();
  if (verdict.has_changed) {
    counters_.last_change = sample.stamp;
    if (options_.detect_changes) {
      LearnAnew();
    } else {
      ++counters_.changes;
    }
  }
  CountTime(front_end_.dt(), Teaches(verdict.phase));
  return verdict;
}

void Estimator::CountTime(double dt, bool teaches) {
  if (!teaches) {
    counters_.on_ground_s += dt;
  } else if (dt < 1.0) {  // not over a hole in the recording
    counters_.airborne_s += dt;
    schedule_.CountFlight(dt);
  }
}

std::optional<KeyframeInterval> Estimator::ReadInterval(const OdometrySample& sample) {
  if (!front_end_.is_chained()) return std::nullopt;
  if (front_end_.is_gap()) {
    ++counters_.gaps;
  } else if (front_end_.is_jump()) {
    ++counters_.jumps;
  }
  return front_end_.Read(sample, window_);
}

void Estimator::BreakChain() {
  front_end_.BreakChain();
  schedule_.BreakChain();
  changes_.Break();
}

void Estimator::RestartChain() {
  front_end_.Restart();
  schedule_.Restart();
  changes_.Restart();
  EmptyWindow();
}

/// All states leave; what they said stays known.
void Estimator::EmptyWindow() {
  while (!window_.keyframes().empty()) {
    solver_->MarginalizeOldest(&window_, uncertainty_.sigma_eta(), nullptr);
  }
  window_.biases().clear();
  factors_.ForgetBias();
}

void Estimator::CarryOn(const Estimator& before, const DynamicModel& declared) {
  uncertainty_.JudgeBy(declared);
  front_end_.CarryOn(before.front_end_);
  schedule_.gate() = before.schedule_.gate();
  schedule_.BreakChain();
  model_noise_.CarryOn(before.model_noise_);
  factors_.CarryOn(before.factors_);
  counters_ = before.counters_;
}

/// Takes what was learned from `since` on back: these keyframes leave as if they had never been.
/// @returns the estimate without them, null if there is none
const Snapshot* Estimator::TakeBack(Stamp since) {
  const auto& keyframes = window_.keyframes();
  if (keyframes.size() < 3 || keyframes.back().stamp <= since) return nullptr;
  std::int64_t first = keyframes.back().id;
  while (first > keyframes.front().id + 2 && window_.keyframe(first - 1).stamp > since) --first;
  const long dropped = static_cast<long>(keyframes.back().id - first) + 1;
  const double dropped_s = ToSeconds(keyframes.back().stamp - window_.keyframe(first - 1).stamp);
  solver_->Release(&window_);
  window_.DropNewestKeyframes(first);
  factors_.TakeBack();
  model_noise_.TakeBack(keyframes.back().id);
  changes_.TakeBack(keyframes.back().stamp);
  schedule_.RestoreGate(since);
  schedule_.CountFlight(-dropped_s);
  counters_.taken_back += dropped;
  counters_.keyframes -= dropped;
  counters_.ground_keyframes += dropped;
  counters_.airborne_s -= dropped_s;
  counters_.on_ground_s += dropped_s;

  const SolveReport report = solver_->Solve(&window_, schedule_.AfterTakingBack(window_));
  TakeSnapshot(keyframes.back().stamp, report);
  snapshot_.airborne = false;
  snapshot_.timing = UpdateTiming();
  return &snapshot_;
}

void Estimator::StartAnew() {
  if (window_.keyframes().empty() && counters_.keyframes == 0) return;
  const int anchor_entry = window_.anchor_entry();
  window_ = Window(&layout_);
  window_.keyframes().Reserve(static_cast<size_t>(MostKeyframes(options_)));
  window_.SetAnchorEntry(anchor_entry);
  solver_ = MakeSolver(options_, *model_);
  uncertainty_.Reset();
  model_noise_ = MakeModelNoise(options_, model_->vehicle(), model_noise_.with_torque());
  changes_ = ChangeWatch(model_->vehicle());
  schedule_.Reset();
  factors_.Reset();
  front_end_.BreakChain();
  front_end_.phases().Forget();
  ++counters_.starts_anew;
  counters_.ground_keyframes += counters_.keyframes;
  counters_.keyframes = counters_.gaps = counters_.jumps = counters_.chains = 0;
  counters_.on_ground_s += counters_.airborne_s;
  counters_.airborne_s = 0.0;
}

// The chain ends here, so that no state spans the change; what was learned stays as it is, only
// less certain.
void Estimator::LearnAnew() {
  ++counters_.changes;
  front_end_.phases().ForgetThrust();
  EmptyWindow();
  front_end_.BreakChain();
  schedule_.LearnAnew();
  uncertainty_.Forget(solver_->ScalePast(uncertainty_.ScaleAfterChange(), &window_));
}

void Estimator::TakeSnapshot(Stamp stamp, const SolveReport& report) {
  snapshot_.stamp = stamp;
  snapshot_.time_s = ToSeconds(stamp - front_end_.start());
  snapshot_.airborne = airborne();
  snapshot_.state = State::FromBlock(window_.keyframes().back().x.data());
  snapshot_.values = window_.values();
  snapshot_.body = model_->Properties(snapshot_.values);
  snapshot_.solve = report;
  snapshot_.battery_voltage_V = front_end_.streams().battery_voltage_V();
  uncertainty_.Fill(
      window_,
      {model_noise_.estimator().in_use(), counters_.airborne_s, factors_.rotor_scale_sigma()},
      solver_.get(), &snapshot_);
  model_noise_.FillResiduals(window_, &snapshot_);
}

void Estimator::Describe(const SolveReport& report, UpdateTiming* timing) const {
  timing->states = static_cast<int>(window_.keyframes().size());
  timing->eliminated = report.eliminated;
  timing->sweeping = report.sweeping;
  timing->aligned = report.aligned;
}

/// What contact is judged by: the estimate, and the gate on inertia as it was.
void Estimator::TellPhases(Stamp stamp) {
  const int k_f = model_->IndexOf("thrust.k_f");
  const double thrust_sigma =
      k_f >= 0 ? snapshot_.sigma[k_f] / std::abs(snapshot_.values[k_f]) : 0.0;
  front_end_.phases().Learn(stamp, snapshot_.values, thrust_sigma);
  schedule_.RememberGate(stamp);
}

void Estimator::MarginalizeOld() {
  const auto& keyframes = window_.keyframes();
  const double keep_s = schedule_.KeepSeconds() + (phases().suspects() ? kMostHeld_s : 0.0);
  const auto is_long = [&] {
    return ToSeconds(keyframes.back().stamp - keyframes.front().stamp) >=
           keep_s - 1.5 / options_.keyframe_rate_hz;
  };
  for (int i = 0; i < kMostLeaving && keyframes.size() > 2 && is_long(); ++i) {
    double dt = 0.0;
    bool yaw_inertia_held = false;
    keyframes.front().ForEach<DynamicsFactor>([&](const Factor&, const DynamicsFactor& dynamics) {
      dt = dynamics.measurement().dt;
      yaw_inertia_held = dynamics.measurement().inertia_fixed[2];
    });
    solver_->MarginalizeOldest(&window_, uncertainty_.sigma_eta(), uncertainty_.leaving());
    LetVary(dt > 0.0 ? dt : 1.0 / options_.keyframe_rate_hz);
    if (dt > 0.0) uncertainty_.AccumulateMarginalized(dt, window_.eta(), yaw_inertia_held);
  }
}

void Estimator::LetVary(double dt) {
  uncertainty_.LetWalk(dt, solver_.get(), &window_);
  if (model_->processes().empty()) return;
  const ModelValues values = window_.values();
  const ParameterVector chain = layout_.ChainFactors(values);
  for (const DynamicModel::ProcessParameter& p : model_->processes()) {
    for (int i = 0; i < layout_.num_estimated(); ++i) {
      if (layout_.model_index(i) != p.index) continue;
      const double sigma = values[p.sigma] / chain[i];
      const double decay = std::exp(-dt / values[p.time_constant]);
      solver_->LetPastVary(i, {decay, (1.0 - decay * decay) * sigma * sigma}, &window_);
    }
  }
}

// One size of what is not modelled holds for the window and for what left it.
void Estimator::RescaleNoise() {
  const auto change = model_noise_.Step(window_);
  if (!change) return;
  const auto weigh = [this](Keyframe* keyframe) { model_noise_.Weigh(keyframe); };
  uncertainty_.Rescale(solver_->Reweigh(uncertainty_.ScaleOf(*change), weigh, &window_));
}

ParameterSet Estimator::ToParameterSet(const DynamicModel& model, const Snapshot& snapshot) {
  ParameterSet set;
  set.effects = model.effect_names();
  for (int i = 0; i < model.num_parameters(); ++i) {
    const ModelParameter& p = model.parameters()[i];
    set.parameters.push_back({p.full_name, p.spec.unit, snapshot.values[i], snapshot.sigma[i],
                              p.estimated, static_cast<bool>(snapshot.observable[i])});
  }
  set.covariance = snapshot.covariance;
  return set;
}

}  // namespace odmc
