#pragma once

#include <Eigen/Core>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "odmc/estimator/estimator.h"
#include "odmc/inspection/online_stream_corrector.h"
#include "odmc/inspection/stream_doubt.h"
#include "odmc/ros/background_analysis.h"
#include "odmc/text/finding.h"

namespace odmc {

/// What speaks against the estimate: what is wrong with the streams, as far as it is mended and as
/// far as it is not, and whether the thirds of the flight agree. Of the estimator thread.
class EstimateTrust {
 public:
  /// Mends a sample by what was found so far.
  void Mend(Sample* sample);
  double OffsetOf(const std::string& stream) const { return mender_.OffsetOf(stream); }

  /// What a comparison of the streams has found. @returns true if streams are mended otherwise from
  ///   now on: they are others
  bool Adopt(BackgroundAnalysis::StreamsFound found);
  /// Every ten seconds of flight: do its thirds agree?
  /// @param values of the estimate, null: none
  void LookBack(const ModelValues* values, bool detects_changes, Estimator* estimator);
  /// Streams that were left out get another chance.
  void ReadmitStreams() { mender_.Readmit(); }
  /// What was learned is forgotten.
  void ForgetEstimate();

  /// What may be wrong with the streams, and was not taken off, belongs to the estimate's sigma.
  /// Where it is most of one, a finding says so (DoubtRemarks()).
  /// @param model of the snapshot
  void Widen(const std::shared_ptr<const DynamicModel>& model, Snapshot* snapshot);

  const std::vector<Finding>& findings() const { return findings_; }

 private:
  void Renew();

  OnlineStreamCorrector mender_;
  std::shared_ptr<const DynamicModel> doubted_;  // whose parameters changes_ are of
  std::vector<StreamDoubt> doubts_;              // what may be wrong with the streams
  std::vector<Eigen::VectorXd> changes_;         // what each doubt may make of the parameters
  bool is_to_remark_ = false;                    // no estimate was widened by these doubts yet
  std::vector<Finding> remarks_;                 // on what doubts make of sigmas
  std::set<std::string> told_;                   // checks that were written to the log
  std::vector<Finding> look_back_;               // by the thirds of the flight
  std::vector<Finding> findings_;                // all of them
  double last_look_s_ = 0.0;                     // flight time of the last look at the thirds
};

}  // namespace odmc
