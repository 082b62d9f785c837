#include "odmc/estimator/learning_schedule.h"

#include <algorithm>
#include <string>

#include "odmc/factors/dynamics_factor.h"

namespace odmc {
namespace {

constexpr double kSettling_s = 1.0;                      // of flight in which a step is not enough
constexpr double kAlignmentGrowth = 1.2;                 // of the window, between alignments
constexpr double kGateEvery_s = 0.1, kGateKept_s = 3.0;  // copies of the gate on inertia
// Keyframes' eliminations, 7 to 12 us each: an update takes 0.4 to 0.7 of its keyframe's period.
constexpr double kWorkPerSecond = 60000.0;
constexpr double kPatience = 10.0;  // times an update's time, where the window is solved as a whole

bool EstimatesInertia(const DynamicModel& model) {
  for (const char* axis : {"inertia.x", "inertia.y", "inertia.z"}) {
    const int k = model.IndexOf(axis);
    if (k >= 0 && model.parameters()[k].estimated) return true;
  }
  return false;
}

}  // namespace

LearningSchedule::LearningSchedule(const DynamicModel* model, const EstimatorOptions* options,
                                   bool with_torque)
    : model_(model),
      options_(options),
      with_torque_(with_torque),
      estimates_inertia_(EstimatesInertia(*model)),
      gate_(options->inertia_gate_r_squared) {}

void LearningSchedule::CountFlight(double dt) { learned_s_ = std::max(0.0, learned_s_ + dt); }

void LearningSchedule::LearnAnew() {
  learned_s_ = 0.0;
  gate_.Break();
}

void LearningSchedule::Restart() {
  gate_.Break();
  gate_before_.clear();
}

void LearningSchedule::Reset() {
  gate_.Restore({});
  gate_before_.clear();
  inertia_was_free_ = {false, false, false};
  aligned_states_ = learned_s_ = 0.0;
  was_learning_ = needs_more_iterations_ = false;
}

// Parameters that vary are one value a window: a long one could not follow them.
bool LearningSchedule::IsLearning() const {
  return learned_s_ < kLearning_s && model_->processes().empty();
}

double LearningSchedule::KeepSeconds() const {
  return IsLearning() ? std::max(kLearning_s, options_->window_s) : options_->window_s;
}

SolverOptions LearningSchedule::ForUpdate(double airborne_s, Window* window) {
  SolverOptions solve;
  // One step an update follows the flight; the first second and a refused step need more, and so
  // does Form E, whose position rows are far stiffer, while parameters still move.
  const bool settling =
      airborne_s < kSettling_s || (IsLearning() && options_->dynamics_form == "euler");
  const int least = settling ? 4 : (needs_more_iterations_ ? 6 : 1);
  solve.max_iterations = std::max(least, options_->max_iterations);
  // Once more before the first keyframes leave.
  const bool has_learned = was_learning_ && !IsLearning();
  was_learning_ = IsLearning();
  const bool has_freed = FreeInertia(window);
  solve.align = needs_more_iterations_ || has_learned ||
                ((settling || IsLearning()) && (has_freed || AlignmentIsDue(*window)));
  solve.max_work = MostWork();
  solve.max_time_s = (settling ? kPatience : 1.0) * options_->max_update_time_s;
  solve.function_tolerance = options_->function_tolerance;
  solve.num_threads = options_->num_threads;
  return solve;
}

/// Of one update.
int LearningSchedule::MostWork() const {
  return static_cast<int>(kWorkPerSecond / options_->keyframe_rate_hz);
}

void LearningSchedule::Solved(const SolverOptions& options, const SolveReport& report,
                              const Window& window) {
  if (options.align || report.aligned) {
    aligned_states_ = static_cast<double>(window.keyframes().size());
  }
  needs_more_iterations_ = !report.improved && !report.converged;
}

SolverOptions LearningSchedule::AfterTakingBack(const Window& window) {
  aligned_states_ = static_cast<double>(window.keyframes().size());
  SolverOptions solve;
  solve.max_iterations = 10;
  solve.align = true;
  solve.max_work = MostWork();
  solve.max_time_s = kPatience * options_->max_update_time_s;
  solve.function_tolerance = options_->function_tolerance;
  solve.num_threads = options_->num_threads;
  return solve;
}

/// While the flight settles, whenever the window has grown by a share; the last time when all is
/// learned.
bool LearningSchedule::AlignmentIsDue(const Window& window) const {
  if (IsLearning() && kAlignmentGrowth * learned_s_ > kLearning_s) return false;
  const auto states = static_cast<double>(window.keyframes().size());
  return states >= kAlignmentGrowth * aligned_states_ || states < aligned_states_;
}

bool LearningSchedule::InertiaIsFree(int axis) const {
  if (options_->inertia_is_known[static_cast<size_t>(axis)]) return false;
  return options_->inertia_gate_r_squared <= 0.0 || gate_.IsOpen(axis);
}

/// Once the gate has opened, what was added before must not hold on to the start value.
/// @returns whether it has opened or closed anywhere
bool LearningSchedule::FreeInertia(Window* window) {
  if (!with_torque_ || !estimates_inertia_) return false;
  std::array<bool, 3> is_free;
  for (int i = 0; i < 3; ++i) is_free[i] = InertiaIsFree(i);
  if (is_free == inertia_was_free_) return false;
  inertia_was_free_ = is_free;
  for (Keyframe& keyframe : window->keyframes()) {
    keyframe.ForEach<DynamicsFactor>([&](Factor* factor, DynamicsFactor* dynamics) {
      for (int i = 0; i < 3; ++i) {
        if (is_free[i]) dynamics->FreeInertia(i);
      }
      window->Touch(factor);
    });
  }
  return true;
}

void LearningSchedule::RememberGate(Stamp stamp) {
  if (!with_torque_) return;
  if (!gate_before_.empty() && ToSeconds(stamp - gate_before_.back().first) < kGateEvery_s) return;
  gate_before_.push_back({stamp, gate_.statistics()});
  while (ToSeconds(stamp - gate_before_.front().first) > kGateKept_s) gate_before_.pop_front();
}

void LearningSchedule::RestoreGate(Stamp since) {
  while (!gate_before_.empty() && gate_before_.back().first > since) {
    gate_.Restore(gate_before_.back().second);
    gate_before_.pop_back();
  }
}

}  // namespace odmc
