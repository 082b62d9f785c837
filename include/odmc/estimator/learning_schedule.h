#pragma once

#include <array>
#include <utility>

#include "odmc/estimator/gates.h"
#include "odmc/estimator/options.h"
#include "odmc/math/ring.h"
#include "odmc/model/dynamic_model.h"
#include "odmc/window/window.h"
#include "odmc/window/window_solver.h"

namespace odmc {

/// What is done when in the course of a flight: how hard each update solves, from when on keyframes
/// leave the window, and which axes of the inertia the flight shows. Thread-compatible.
class LearningSchedule {
 public:
  /// Of flight in which nothing leaves [s]. What leaves the window stays linearized where it was;
  /// before, parameters that multiply each other (drag and the height of the centre of mass) are
  /// guesses, and a guess would stay.
  static constexpr double kLearning_s = 3.0;

  /// Both must outlive the schedule.
  LearningSchedule(const DynamicModel* model, const EstimatorOptions* options, bool with_torque);

  /// Flight goes on, or a part of it is taken back (negative) [s].
  void CountFlight(double dt);
  /// The parameters are new: the flight starts to teach anew.
  void LearnAnew();
  /// Back to the start.
  void Reset();
  /// The next interval does not follow on the last one.
  void BreakChain() { gate_.Break(); }
  /// The same, and the clock is another one.
  void Restart();

  /// True while the whole flight stays in the window.
  bool IsLearning() const;
  /// Length of the window in force [s].
  double KeepSeconds() const;

  /// How to solve the next update; frees axes of the inertia in `window` on the way.
  /// @param airborne_s flight time so far
  SolverOptions ForUpdate(double airborne_s, Window* window);
  /// How it went.
  void Solved(const SolverOptions& options, const SolveReport& report, const Window& window);
  /// How to solve a window from which keyframes were taken back.
  SolverOptions AfterTakingBack(const Window& window);

  InertiaGate& gate() { return gate_; }
  const InertiaGate& gate() const { return gate_; }
  bool InertiaIsFree(int axis) const;
  /// Keeps a copy of what the gate has seen, a few seconds of them.
  void RememberGate(Stamp stamp);
  /// Back to what the gate had seen at `since`.
  void RestoreGate(Stamp since);

 private:
  bool FreeInertia(Window* window);
  int MostWork() const;
  bool AlignmentIsDue(const Window& window) const;

  const DynamicModel* model_;
  const EstimatorOptions* options_;
  bool with_torque_, estimates_inertia_;  // about any axis
  InertiaGate gate_;
  Ring<std::pair<Stamp, InertiaGate::Statistics>> gate_before_;  // one a tenth of a second
  std::array<bool, 3> inertia_was_free_ = {false, false, false};
  double learned_s_ = 0.0;  // flown since the parameters were last new
  bool was_learning_ = false;
  double aligned_states_ = 0.0;         // in the window at the last alignment
  bool needs_more_iterations_ = false;  // the last solve took no step
};

}  // namespace odmc
