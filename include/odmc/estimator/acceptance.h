#pragma once

#include <optional>
#include <string>
#include <vector>

#include "odmc/estimator/estimator.h"
#include "odmc/text/finding.h"

namespace odmc {

/// When an estimate is good enough to be handed to others.
struct AcceptanceOptions {
  double accept_relative_sigma = 0.05;  ///< largest sigma over |value| [-], > 0
  double accept_hold_s = 1.0;           ///< how long all must hold [s], >= 0

  template <typename Visitor>
  void Visit(Visitor* v) {
    v->Field("accept_relative_sigma", &accept_relative_sigma);
    v->Field("accept_hold_s", &accept_hold_s);
  }

  bool IsValid(std::string* error) const;
};

/// Decides what of an estimate others may use.
///
/// A parameter is sure if its sigma is below accept_relative_sigma of its value (where the value
/// may be zero, or below twice that share of its prior sigma or natural size) and its sign is
/// physical. What is not sure keeps the value of the vehicle file, and the
/// others become what they are given that value: the estimate's Gaussian, conditioned. Where that
/// gives one the wrong sign, it is held back, too. So one weak parameter does not hold up the rest,
/// and nothing certain leans on a guess. Accepted is what has
///  - k_f, without which no model is of use, among the sure if the model estimates it,
///  - nothing unphysical, and no k_f three times the vehicle file's (ThrustDoubt()),
/// for accept_hold_s without a break. Thread-compatible.
class Acceptance {
 public:
  explicit Acceptance(const AcceptanceOptions& options) : options_(options) {}

  /// @param findings what is known against the estimate: only a good one is accepted
  /// @returns whether the estimate is accepted as of this snapshot
  bool Update(const DynamicModel& model, const Snapshot& snapshot,
              const std::vector<Finding>& findings = {});

  bool accepted() const { return accepted_; }
  /// Why not, in words; empty where nothing is wrong (it may still have to last).
  const std::vector<std::string>& reasons() const { return reasons_; }
  /// Parameters that keep the vehicle file's value, each with the reason.
  const std::vector<std::string>& held_back() const { return held_back_; }

  /// The newest snapshot with the values, sigmas and covariance to be used; what is held back is
  /// not observable there.
  const Snapshot& Usable() const { return usable_; }

  void Reset();

 private:
  std::string Objection(const ModelParameter& parameter, int index, const Snapshot& snapshot) const;
  void HoldBack(const DynamicModel& model, const Snapshot& snapshot, std::vector<bool> sure);

  AcceptanceOptions options_;
  std::optional<Stamp> good_since_;
  bool accepted_ = false;
  std::vector<bool> sure_;  // at the last update
  std::vector<std::string> reasons_, held_back_;
  Snapshot usable_;
};

}  // namespace odmc
