#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <thread>
#include <vector>

#include "odmc/analysis/torque_bands.h"
#include "odmc/attribution/residual_watch.h"
#include "odmc/estimator/options.h"
#include "odmc/inspection/stream_inspection.h"
#include "odmc/ros/guarded.h"
#include "odmc/ros/input_queue.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// A thread of low priority that looks at what the model leaves unexplained, compares the streams
/// with each other, and asks them whether a k_m that is held is right: a look takes a second or so
/// and can wait, the estimator can't. What it shares with the estimator thread is under one lock.
class BackgroundAnalysis {
 public:
  /// The newest minute of the streams as they come, and what they are inspected for.
  struct StreamsSeen {
    FlightLog log;
    Vehicle vehicle;
    std::shared_ptr<const DynamicModel> model;
    std::optional<ModelValues> values;  ///< of the model; empty: not estimated yet
    double k_f_sigma = 0.0;             ///< [N s²]
  };
  struct StreamsFound {
    StreamInspection inspection;
    std::shared_ptr<const DynamicModel> model;
    std::vector<Eigen::VectorXd> changes;  ///< of its parameters, without each doubt
    TorqueBands bands;                     ///< BandsOf() the same
  };

  /// @param on_look called by the thread
  /// @param queue tells when to stop; outlives this
  BackgroundAnalysis(const EstimatorOptions& estimator,
                     std::function<void(const ResidualAnalysis&)> on_look, InputQueue* queue);
  ~BackgroundAnalysis() { Join(); }
  void Join();

  /// What the bands of frequency say where k_m is held and there are values; else nothing. Takes
  /// some tenths of a second.
  static TorqueBands BandsOf(const StreamsSeen& seen);

  // The estimator thread.

  void Watch(std::shared_ptr<ResidualWatch> watch);
  /// Null: the residual is not watched, or not yet.
  std::shared_ptr<ResidualWatch> watch();
  void Inspect(StreamsSeen seen);
  /// Never waits: nothing where the other thread holds the lock.
  std::optional<StreamsFound> TakeInspection();
  /// What on_look() has proposed to add to the model.
  std::optional<ResidualAnalysis> TakeProposal();

  // Any thread.

  void Propose(const ResidualAnalysis& look);

 private:
  struct Shared {
    std::shared_ptr<ResidualWatch> watch;
    std::optional<ResidualAnalysis> proposal;
    std::optional<StreamsSeen> seen;
    std::optional<StreamsFound> found;
  };

  void Run();
  void InspectIfDue();

  EstimatorOptions estimator_;
  const std::function<void(const ResidualAnalysis&)> on_look_;
  InputQueue* const queue_;
  Guarded<Shared> shared_;
  std::thread thread_;  // started last
};

}  // namespace odmc
