#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "odmc/estimator/change_watch.h"
#include "odmc/estimator/factor_builder.h"
#include "odmc/estimator/front_end.h"
#include "odmc/estimator/learning_schedule.h"
#include "odmc/estimator/model_noise.h"
#include "odmc/estimator/options.h"
#include "odmc/estimator/snapshot.h"
#include "odmc/estimator/uncertainty.h"
#include "odmc/model/parameter_set.h"
#include "odmc/window/window.h"
#include "odmc/window/window_solver.h"

namespace odmc {

class UpdateTimer;

/// What happened so far, in numbers.
struct EstimatorCounters {
  long keyframes = 0;         ///< that entered the window
  long ground_keyframes = 0;  ///< left out: not in free flight
  long taken_back = 0;        ///< of these, those that had been in the window already
  long starts_anew = 0;       ///< times all that was learned was worth nothing
  long chains = 0;            ///< chains of states: 1 plus the gaps
  long gaps = 0;              ///< holes in a stream, missing rotor speeds
  long jumps = 0;             ///< odometry that moved without velocity
  long changes = 0;           ///< of the vehicle, after which it learned anew
  Stamp last_change = 0;      ///< when the last of these was seen
  long refused_updates = 0;   ///< solves that were not usable
  double on_ground_s = 0.0;   ///< not in free flight
  double airborne_s = 0.0;
};

/// The window between the solve of an update and its marginalization, for benchmarks and tests.
struct SolvedWindow {
  const DynamicModel& model;
  const SolveReport& solve;
  const Eigen::VectorXd& sigma_eta;  ///< of eta, not inflated
  const ModelNoise& model_noise;
  Window* window;
  WindowSolver* solver;
};

/// The pipeline in one object: samples go in, snapshots come out. Runs the same offline and live.
///
///   FrontEnd -> FactorBuilder -> Window -> WindowSolver -> Snapshot (Uncertainty) -> marginalize
///
/// LearningSchedule says how hard to solve and when keyframes leave, ModelNoise how much to believe
/// the model. Thread-compatible: one thread owns it.
class Estimator {
 public:
  /// @param model must outlive the estimator
  /// @throws std::invalid_argument if the options are not valid
  Estimator(const DynamicModel* model, const EstimatorOptions& options, bool with_torque);
  ~Estimator();

  void Add(const OdometrySample& sample) { front_end_.Add(sample); }
  void Add(const ImuSample& sample) { front_end_.Add(sample); }
  void Add(const RotorSample& sample) { front_end_.Add(sample); }
  void Add(const BatterySample& sample) { front_end_.Add(sample); }
  /// No sample follows.
  void Finish() { front_end_.Finish(); }
  /// For samples that come as they are taken: see Synchroniser::SetArrivalClock().
  void SetArrivalClock(std::function<double()> now_s) {
    front_end_.SetArrivalClock(std::move(now_s));
  }

  /// Processes at most one keyframe. @returns a snapshot, good until the next call, if one was
  /// processed in free flight, or if something that was learned had to be taken back; else null
  const Snapshot* Step();

  /// True if the last Step() consumed a keyframe, airborne or not: there may be more.
  bool made_progress() const { return made_progress_; }

  /// Stamp of the keyframe the last Step() consumed.
  Stamp last_keyframe_stamp() const { return front_end_.last() ? front_end_.last()->stamp : 0; }

  /// Forgets samples and states, keeps what was learned about the parameters (a new flight or a
  /// clock that stepped back).
  void RestartChain();
  /// Back to the priors: all that was learned so far is not of this flight, or not of streams as
  /// they are from now on.
  void StartAnew();

  /// Goes on where an estimator of the same vehicle with another model stands: samples, ground and
  /// noise are taken over, flight time and counters go on; states and parameters start anew.
  /// @param declared the model with the priors by which parameters count as observable (those of
  ///   this estimator's model hold what `before` has learned); same parameters as the model
  /// @pre nothing was added yet
  void CarryOn(const Estimator& before, const DynamicModel& declared);

  /// Stamp from which flight time counts; 0 before the first keyframe.
  Stamp start() const { return front_end_.start(); }

  const EstimatorCounters& counters() const { return counters_; }
  const SynchroniserCounters& stream_counters() const { return front_end_.streams().counters(); }
  const std::string& waiting_for() const { return front_end_.streams().waiting_for(); }
  /// True while the flight teaches: nothing but the air acts on the vehicle.
  bool airborne() const { return phases().has_begun() && phases().teaches(); }
  const PhaseDetector& phases() const { return front_end_.phase_detector(); }
  const DynamicModel& model() const { return *model_; }
  const EstimatorOptions& options() const { return options_; }
  /// What is observable is judged by the priors of `declared`, not by this model's, which may know
  /// more of the same flight.
  void JudgeBy(const DynamicModel& declared) { uncertainty_.JudgeBy(declared); }
  /// Keyframes for whose stamp this is true teach the estimate nothing: what is judged on them has
  /// not seen them.
  void SetHeldOut(std::function<bool(Stamp)> is_held_out) {
    front_end_.SetHeldOut(std::move(is_held_out));
  }

  /// Compares what the thirds of the flight so far say by themselves. @returns the parameters about
  /// which they disagree beyond sampling error (LastLookThreshold()), serial correlation included
  std::vector<ThirdsDifference> CompareThirds() { return uncertainty_.CompareThirds(window_); }

  /// Calls `observe` in every update between the solve and the marginalization, untimed.
  void SetObserver(std::function<void(const SolvedWindow&)> observe) {
    observe_ = std::move(observe);
  }

  OdometryNoise odometry_noise() const { return front_end_.noise().odometry(); }

  /// The estimate as a parameter set, for files and messages.
  static ParameterSet ToParameterSet(const DynamicModel& model, const Snapshot& snapshot);

 private:
  const Snapshot* Update(const OdometrySample& sample, UpdateTimer* timer);
  PhaseVerdict FollowPhase(const OdometrySample& sample);
  void CountTime(double dt, bool teaches);
  std::optional<KeyframeInterval> ReadInterval(const OdometrySample& sample);
  /// The next keyframe does not follow on the last one.
  void BreakChain();
  void EmptyWindow();
  const Snapshot* TakeBack(Stamp since);
  void LearnAnew();
  void TakeSnapshot(Stamp stamp, const SolveReport& report);
  void Describe(const SolveReport& report, UpdateTiming* timing) const;
  void TellPhases(Stamp stamp);
  void MarginalizeOld();
  /// Parameters that vary may have moved by what they do in `dt`.
  void LetVary(double dt);
  /// Weighs all that was measured anew where its size has grown or shrunk.
  void RescaleNoise();

  const DynamicModel* model_;
  EstimatorOptions options_;
  ParameterLayout layout_;
  FrontEnd front_end_;
  Window window_;
  std::unique_ptr<WindowSolver> solver_;
  LearningSchedule schedule_;
  ModelNoise model_noise_;
  FactorBuilder factors_;
  ChangeWatch changes_;
  Uncertainty uncertainty_;
  Snapshot snapshot_;  // the newest, filled in place
  EstimatorCounters counters_;
  std::function<void(const SolvedWindow&)> observe_;
  bool made_progress_ = false;
};

}  // namespace odmc
