#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "odmc/estimator/acceptance.h"
#include "odmc/estimator/estimator.h"
#include "odmc/fleet/unlike_history.h"
#include "odmc/model/parameter_set.h"
#include "odmc/ros/background_analysis.h"
#include "odmc/ros/estimate_publisher.h"
#include "odmc/ros/estimate_trust.h"
#include "odmc/ros/estimator_setup.h"
#include "odmc/ros/learning_progress.h"
#include "odmc/ros/node_status.h"

namespace odmc {

/// The estimate from its start to the node's end: the vehicle as it is known by now, its model and
/// estimator, the newest estimate and what is thought of it. Of the estimator thread.
class EstimateSession {
 public:
  /// @param setup outlives the session
  explicit EstimateSession(const EstimatorNodeSetup* setup);

  /// The vehicle of the set-up with the mounts that were looked up and the effects that were added.
  const Vehicle& vehicle() const { return vehicle_; }
  /// To complete its mounts. @pre nothing is estimated yet
  Vehicle* mutable_vehicle() { return &vehicle_; }

  /// Makes model and estimator; what is estimated starts at the priors.
  void Start(bool with_torque);
  bool has_started() const { return estimator_ != nullptr; }
  /// @pre has_started(), as for all below
  Estimator& estimator() { return *estimator_; }
  const Estimator& estimator() const { return *estimator_; }
  const std::shared_ptr<const DynamicModel>& model() const { return model_; }

  /// Starts anew with the effects and priors of the set-up.
  void Reset(bool with_torque);
  /// The clock stepped back: a new chain of states, parameters are kept.
  void RestartChain();
  /// While frozen, nothing more is learned. May come before the start.
  void Freeze(bool is_frozen);

  /// Mends a sample by what is known of the streams.
  void Mend(Sample* sample) { trust_.Mend(sample); }
  /// The estimator's Step(); where this starts anew, the estimate is forgotten.
  const Snapshot* Step();
  /// A new estimate: judges it, and widens its sigmas by what may be wrong with the streams.
  void Take(Snapshot snapshot);
  /// No new estimate: the last one still stands, on the ground and while frozen. @pre last()
  void KeepLast();

  /// A look at the streams, for the background.
  BackgroundAnalysis::StreamsSeen SeenIn(FlightLog log) const;
  /// What it has found. Where streams are mended otherwise from now on, all is learned anew.
  void Adopt(BackgroundAnalysis::StreamsFound found);
  /// Adds an effect that was found to the model; the estimate goes on.
  /// @returns false if it does not fit the present estimate, or cannot be added (said in the log)
  bool Extend(const ResidualAnalysis& found, bool with_torque);

  /// The newest estimate; null: none.
  const Snapshot* last() const { return last_ ? &*last_ : nullptr; }
  /// What last() is published with.
  EstimatePublisher::Context Context() const;
  /// Why last() can't be accepted as it is; empty if it can.
  std::string ObjectionToAccepting() const;
  bool is_accepted() const { return acceptance_.accepted(); }
  /// last() with where it comes from, for a file. @pre last()
  ParameterSet ToSave() const;

  /// Sees whether learning goes on. @param missing stream the estimator waits for; may be empty
  void LookAtProgress(const std::string& missing);
  bool comes_on() const { return progress_.comes_on(); }
  /// Tells of estimator and estimate what the session knows.
  void Fill(NodeStatus* status) const;

 private:
  void HoldOut();
  void Forget(const char* why);
  void LearnOfReaction(const BackgroundAnalysis::StreamsFound& found);
  void FillEstimate(NodeStatus* status) const;
  std::vector<std::string> UnlikeHistorySentences() const;

  const EstimatorNodeSetup& setup_;
  Vehicle vehicle_;
  std::shared_ptr<const DynamicModel> model_;  // others get it by the status
  std::unique_ptr<Estimator> estimator_;
  EstimateTrust trust_;
  ReactionWatch reaction_watch_;
  Acceptance acceptance_;
  LearningProgress progress_;
  std::optional<Snapshot> last_;
  std::shared_ptr<const DynamicModel> last_model_;  // of last_
  std::optional<HistoryWatch> history_watch_;       // where a fleet's flights were before
  std::vector<UnlikeHistory> unlike_history_;
  std::string added_effects_;
  bool is_frozen_ = false;
  long starts_anew_ = 0;  // of the estimator, as far as they are dealt with
};

}  // namespace odmc
