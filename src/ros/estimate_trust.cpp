#include "odmc/ros/estimate_trust.h"

#include <ros/console.h>

#include <cmath>
#include <utility>

#include "odmc/analysis/calibration.h"
#include "odmc/analysis/phase_findings.h"

namespace odmc {
namespace {

constexpr double kLookEvery_s = 10.0;

}  // namespace

void EstimateTrust::Mend(Sample* sample) {
  std::visit([this](auto& s) { mender_.Mend(&s); }, *sample);
}

bool EstimateTrust::Adopt(BackgroundAnalysis::StreamsFound found) {
  const bool is_new = mender_.Adopt(found.inspection);
  // A look at a stand finds doubts, but not what they change: what is known of that holds.
  const bool is_blind =
      !found.inspection.doubts.empty() && found.changes.empty() && doubted_ == found.model;
  doubted_ = found.model;
  if (!is_blind) {
    doubts_ = std::move(found.inspection.doubts);
    changes_ = std::move(found.changes);
  }
  is_to_remark_ = true;
  for (const Finding& finding : mender_.findings()) {
    if (told_.insert(finding.check).second) ROS_WARN("%s", Sentence(finding).c_str());
  }
  Renew();
  return is_new;
}

void EstimateTrust::LookBack(const ModelValues* values, bool detects_changes,
                             Estimator* estimator) {
  const EstimatorCounters& counters = estimator->counters();
  if (counters.airborne_s < last_look_s_ + kLookEvery_s) return;
  last_look_s_ = counters.airborne_s;
  const std::vector<ThirdsDifference> thirds = estimator->CompareThirds();
  look_back_.clear();
  if (values != nullptr) look_back_ = LastLookFindings(estimator->model(), *values, thirds);
  if (counters.changes > 0 && !detects_changes) {
    look_back_.push_back(VehicleChanged(counters.last_change, estimator->start()));
  }
  Renew();
}

void EstimateTrust::ForgetEstimate() {
  look_back_.clear();
  remarks_.clear();
  is_to_remark_ = true;
  last_look_s_ = 0.0;
  Renew();
}

void EstimateTrust::Widen(const std::shared_ptr<const DynamicModel>& model, Snapshot* snapshot) {
  if (doubted_ != model) return;
  for (const Eigen::VectorXd& change : changes_) {
    if (!change.allFinite()) continue;
    for (Eigen::Index i = 0; i < change.size(); ++i) {
      if (snapshot->sigma[i] > 0.0) snapshot->sigma[i] = std::hypot(snapshot->sigma[i], change[i]);
    }
    if (snapshot->covariance.rows() == change.size()) {
      snapshot->covariance += change * change.transpose();
    }
  }
  if (!is_to_remark_) return;
  is_to_remark_ = false;
  remarks_ = DoubtRemarks(doubts_, changes_, Estimator::ToParameterSet(*model, *snapshot));
  for (const Finding& remark : remarks_) {
    if (told_.insert(remark.check).second) ROS_INFO("%s", Sentence(remark).c_str());
  }
  Renew();
}

void EstimateTrust::Renew() {
  findings_ = mender_.findings();
  findings_.insert(findings_.end(), remarks_.begin(), remarks_.end());
  findings_.insert(findings_.end(), look_back_.begin(), look_back_.end());
}

}  // namespace odmc
