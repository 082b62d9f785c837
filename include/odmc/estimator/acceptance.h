#pragma once

#include <optional>
#include <string>
#include <vector>

#include "odmc/estimator/estimator.h"

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

/// Accepts an estimate once, for accept_hold_s without a break,
///  - every estimated and observable parameter has a sigma below accept_relative_sigma of its
///    value or, where
///    the value may be zero, below twice that share of its prior
///    sigma or natural size,
///  - k_f, without which no model is of use, is among them if the model estimates it,
///  - nothing is unphysical.
/// Thread-compatible.
class Acceptance {
 public:
  explicit Acceptance(const AcceptanceOptions& options) : options_(options) {}

  /// @returns whether the estimate is accepted as of this snapshot
  bool Update(const DynamicModel& model, const Snapshot& snapshot);

  bool accepted() const { return accepted_; }
  /// Why not, in words; empty where nothing is wrong (it may still have to last).
  const std::vector<std::string>& reasons() const { return reasons_; }

  void Reset();

 private:
  AcceptanceOptions options_;
  std::optional<Stamp> good_since_;
  bool accepted_ = false;
  std::vector<std::string> reasons_;
};

}  // namespace odmc
