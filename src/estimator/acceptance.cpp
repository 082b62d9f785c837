#include "odmc/estimator/acceptance.h"

#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "odmc/model/plausibility.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

constexpr double kStaysSure = 1.5;     // times the limit: what was sure once does not come and go
constexpr double kShareOfPrior = 2.0;  // 10 % of the prior's sigma where 5 % of the value is asked

/// Largest sigma to accept. A value that may be zero is judged against what was known before, too:
/// its prior or its natural size.
double SigmaLimit(const ParameterSpec& spec, double value, double share) {
  const double relative = share * std::abs(value);
  if (spec.transform == ParameterTransform::kLog) return relative;
  return std::max(relative, kShareOfPrior * share * std::max(spec.prior_sigma, spec.scale));
}

// `snapshot` given that what is not sure has its prior value.
Snapshot HeldBack(const DynamicModel& model, const Snapshot& snapshot,
                  const std::vector<bool>& sure) {
  std::vector<int> kept, held;
  for (int i = 0; i < model.num_parameters(); ++i) {
    if (!model.parameters()[i].estimated) continue;
    (sure[i] ? kept : held).push_back(i);
  }
  Snapshot usable = snapshot;
  if (held.empty()) return usable;
  Eigen::VectorXd shift(static_cast<Eigen::Index>(held.size()));
  for (size_t k = 0; k < held.size(); ++k) {
    const int i = held[k];
    shift[static_cast<Eigen::Index>(k)] =
        model.parameters()[i].spec.prior_value - snapshot.values[i];
    usable.values[i] = model.parameters()[i].spec.prior_value;
    usable.observable[i] = false;
  }
  // Correlations, so that units do not matter to the decomposition.
  const Eigen::VectorXd size =
      snapshot.covariance.diagonal().cwiseSqrt().cwiseMax(std::numeric_limits<double>::min());
  const Eigen::VectorXd held_size = size(held);
  const Eigen::MatrixXd held_inverse = held_size.cwiseInverse().asDiagonal();
  const Eigen::MatrixXd among_held = held_inverse * snapshot.covariance(held, held) * held_inverse;
  const Eigen::MatrixXd across = snapshot.covariance(kept, held) * held_inverse;
  const Eigen::MatrixXd gain =
      among_held.completeOrthogonalDecomposition().solve(across.transpose()).transpose();
  const Eigen::VectorXd moved = gain * (held_inverse * shift);
  const Eigen::MatrixXd left = snapshot.covariance(kept, kept) - gain * across.transpose();
  for (size_t k = 0; k < kept.size(); ++k) {
    const auto row = static_cast<Eigen::Index>(k);
    usable.values[kept[k]] += moved[row];
    usable.sigma[kept[k]] = std::sqrt(std::max(left(row, row), 0.0));
  }
  usable.covariance(kept, kept) = left;
  usable.covariance(kept, held).setZero();
  usable.covariance(held, kept).setZero();
  return usable;
}

}  // namespace

bool AcceptanceOptions::IsValid(std::string* error) const {
  if (accept_relative_sigma > 0.0 && accept_hold_s >= 0.0) return true;
  if (error != nullptr) {
    *error = "accept_relative_sigma must be positive and accept_hold_s not negative";
  }
  return false;
}

std::string Acceptance::Objection(const ModelParameter& parameter, int index,
                                  const Snapshot& snapshot) const {
  const double value = snapshot.values[index], sigma = snapshot.sigma[index];
  if (HasWrongSign(parameter.spec.sign, value, sigma)) {
    return parameter.full_name + Format(" = %.3g +- %.2g", value, sigma) + " " +
           parameter.spec.unit + " has the wrong sign";
  }
  const bool was_sure = index < static_cast<int>(sure_.size()) && sure_[index];
  const double limit = (was_sure ? kStaysSure : 1.0) *
                       SigmaLimit(parameter.spec, value, options_.accept_relative_sigma);
  if (sigma <= limit) return "";
  return parameter.full_name + Format(": sigma %.2g is above %.2g ", sigma, limit) +
         parameter.spec.unit;
}

// What is held back can push another past zero, which is then held back, too.
void Acceptance::HoldBack(const DynamicModel& model, const Snapshot& snapshot,
                          std::vector<bool> sure) {
  for (bool again = true; again;) {
    again = false;
    usable_ = HeldBack(model, snapshot, sure);
    for (int i = 0; i < model.num_parameters(); ++i) {
      const ModelParameter& p = model.parameters()[i];
      if (!p.estimated || !sure[i] || p.full_name == "thrust.k_f") continue;
      const double value = usable_.values[i], sigma = usable_.sigma[i];
      if (!HasWrongSign(p.spec.sign, value, sigma)) continue;
      sure[i] = false;
      again = true;
      held_back_.push_back(p.full_name + Format(" = %.3g +- %.2g", value, sigma) + " " +
                           p.spec.unit + " has the wrong sign beside what is held back");
    }
  }
}

bool Acceptance::Update(const DynamicModel& model, const Snapshot& snapshot,
                        const std::vector<Finding>& findings) {
  reasons_.clear();
  held_back_.clear();
  if (!snapshot.values.allFinite() || !snapshot.sigma.allFinite() ||
      !snapshot.covariance.allFinite()) {
    reasons_.push_back("the estimate is not a number");
    good_since_.reset();
    accepted_ = false;
    return false;
  }
  std::vector<bool> sure(model.num_parameters(), true);
  for (int i = 0; i < model.num_parameters(); ++i) {
    const ModelParameter& p = model.parameters()[i];
    if (!p.estimated) continue;
    const std::string objection = Objection(p, i, snapshot);
    if (objection.empty()) continue;
    sure[i] = false;
    (p.full_name == "thrust.k_f" ? reasons_ : held_back_).push_back(objection);
  }
  sure_ = sure;
  HoldBack(model, snapshot, std::move(sure));
  const std::string doubt = ThrustDoubt(model, snapshot.values);
  if (!doubt.empty()) reasons_.push_back(doubt);
  for (const std::string& sentence : UnphysicalValues(model, usable_.values, usable_.sigma)) {
    reasons_.push_back(sentence);
  }
  for (const Finding& finding : findings) {
    if (finding.leaves != Trust::kGood) reasons_.push_back(Sentence(finding));
  }
  if (!reasons_.empty()) {
    good_since_.reset();
    accepted_ = false;
    return false;
  }
  if (!good_since_) good_since_ = snapshot.stamp;
  accepted_ = ToSeconds(snapshot.stamp - *good_since_) >= options_.accept_hold_s;
  return accepted_;
}

void Acceptance::Reset() {
  good_since_.reset();
  accepted_ = false;
  sure_.clear();
  reasons_.clear();
  held_back_.clear();
  usable_ = Snapshot();
}

}  // namespace odmc
