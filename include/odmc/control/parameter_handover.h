#pragma once

#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "odmc/model/dynamic_model.h"
#include "odmc/model/parameter_set.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// When a controller believes an estimate, and when it stops to.
struct HandoverOptions {
  double handover_max_age_s = 1.0;            ///< of an estimate when it is offered [s], > 0
  double handover_max_thrust_ratio = 3.0;     ///< of k_f over nominal, up or down [-], > 1
  double handover_max_relative_sigma = 0.15;  ///< of k_f, I_x, I_y: over the value [-], > 0
  double handover_stale_s = 2.0;              ///< silence after which the estimate is stale [s]
  double handover_hold_s = 300.0;  ///< a stale estimate is used that long, then nominal [s]
  /// Largest change in use of each parameter, of its value or its natural size [1/s].
  double handover_change_1_s = 0.5;
  double handover_judge_s = 2.0;         ///< of flight before and after a change, to judge it [s]
  double handover_worse_ratio = 1.5;     ///< of tracking errors, after over before [-], > 1
  double handover_worse_floor_m = 0.05;  ///< and at least so much more [m]
  double handover_refuse_s = 10.0;       ///< no offers after a roll-back [s]

  /// Shows every field, by key, to a reader or a printer.
  template <typename Visitor>
  void Visit(Visitor* v) {
    v->Field("handover_max_age_s", &handover_max_age_s);
    v->Field("handover_max_thrust_ratio", &handover_max_thrust_ratio);
    v->Field("handover_max_relative_sigma", &handover_max_relative_sigma);
    v->Field("handover_stale_s", &handover_stale_s);
    v->Field("handover_hold_s", &handover_hold_s);
    v->Field("handover_change_1_s", &handover_change_1_s);
    v->Field("handover_judge_s", &handover_judge_s);
    v->Field("handover_worse_ratio", &handover_worse_ratio);
    v->Field("handover_worse_floor_m", &handover_worse_floor_m);
    v->Field("handover_refuse_s", &handover_refuse_s);
  }

  /// True if usable; otherwise false with a sentence for the user in `error`.
  bool IsValid(std::string* error) const;
};

/// Which parameters the controller uses.
enum class HandoverState {
  kNominal,     ///< those of the vehicle file
  kFollowing,   ///< the newest accepted estimate
  kHolding,     ///< the last accepted estimate; the estimator is silent
  kRolledBack,  ///< those in use before a change after which tracking got worse
};
const char* NameOf(HandoverState state);

/// A step from one state to another, or an offer that was refused.
struct HandoverEvent {
  Stamp stamp = 0;
  HandoverState from = HandoverState::kNominal, to = HandoverState::kNominal;
  std::string reason;  ///< a sentence
};

/// Lets a controller use an estimate safely. Checks every offer again (finite, plausible, certain
/// enough, fresh, of this vehicle), moves to it at a limited rate, watches the tracking error and
/// goes back: to the parameters in use before a change if tracking got worse, to nominal ones if
/// it did so before. A silent estimator leaves the last accepted estimate in use for a while.
/// Time only comes in by arguments. Thread-compatible.
class ParameterHandover {
 public:
  /// @param nominal the vehicle as its file describes it
  /// @throws std::invalid_argument for options that are not valid
  ParameterHandover(const HandoverOptions& options, const Vehicle& nominal);

  /// Offers an estimate the estimator has accepted.
  /// @param stamp of the estimate
  /// @returns a sentence why it is refused; empty if it is taken
  std::string Consider(const ParameterSet& set, Stamp stamp, Stamp now);

  /// Moves the parameters in use, judges changes. To be called at a steady rate.
  /// @param tracking_error_m distance from the reference; nothing while nothing is tracked
  /// @returns true if parameters in use have changed
  bool Update(Stamp now, std::optional<double> tracking_error_m);

  const std::shared_ptr<const DynamicModel>& model() const { return model_; }
  const ModelValues& values() const { return values_; }
  HandoverState state() const { return state_; }
  /// How far the parameters in use are on the way to their goal, 0 to 1: of the one with the
  /// longest.
  double progress() const { return progress_; }
  /// Stamp of the estimate in use or on the way; 0 for nominal ones.
  Stamp estimate_stamp() const { return goal_.stamp; }
  double tracking_rmse_m() const;  ///< of the newest handover_judge_s

  /// What has happened since the last call.
  std::vector<HandoverEvent> TakeEvents();
  long refused() const { return refused_; }

  /// Back to nominal parameters at once (a new flight).
  void Reset(Stamp now);

 private:
  struct Parameters {
    Stamp stamp = 0;  // of the estimate; 0: nominal
    ModelValues values;
    // Of tracking while they were in use; empty: not flown for long enough to say.
    std::optional<double> rmse_m;
  };
  struct Error {
    Stamp stamp;
    double squared;
  };

  std::string Objection(const ParameterSet& set, const DynamicModel& model,
                        const ModelValues& values, const Eigen::VectorXd& sigma, Stamp stamp,
                        Stamp now) const;
  void Adopt(std::shared_ptr<const DynamicModel> model);
  void Watch(Stamp now, std::optional<double> tracking_error_m);
  void Judge(Stamp now);
  void CheckAge(Stamp now);
  bool Move(Stamp now);
  std::optional<double> Baseline() const;
  void GoTo(const Parameters& goal);
  void Enter(HandoverState state, const std::string& reason, Stamp now);
  // What a change of each parameter is measured by: the larger value or its natural size.
  Eigen::VectorXd Sizes(const ModelValues& a, const ModelValues& b) const;
  double LargestChange(const ModelValues& from, const ModelValues& to) const;

  HandoverOptions options_;
  Vehicle nominal_;
  std::shared_ptr<const DynamicModel> model_;
  std::vector<std::string> effects_;  // of model_
  ModelValues values_;                // in use
  HandoverState state_ = HandoverState::kNominal;
  Parameters goal_;                   // where values_ move
  Parameters proven_;                 // in use and good before the change on trial
  std::optional<Stamp> trial_since_;  // a change is being judged
  ModelValues start_;                 // where the move began
  double progress_ = 1.0;
  std::optional<Stamp> last_update_, newest_offer_, refuse_until_;
  std::deque<Error> errors_;  // of the newest handover_judge_s
  std::vector<HandoverEvent> events_;
  std::string last_refusal_;
  long refused_ = 0;
};

}  // namespace odmc
