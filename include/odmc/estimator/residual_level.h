#pragma once

#include "odmc/estimator/snapshot.h"
#include "odmc/window/window.h"

namespace odmc {

/// What the newest interval leaves unexplained, and its running size. Thread-compatible.
class ResidualLevel {
 public:
  /// @param memory_s of the running size
  ResidualLevel(double memory_s, bool with_torque)
      : memory_s_(memory_s), with_torque_(with_torque) {}

  /// Fills the snapshot's residuals. @pre its body is set
  void Fill(const Window& window, Snapshot* snapshot);
  /// Goes on from the size that another one has seen.
  void CarryOn(const ResidualLevel& before) {
    force_power_ = before.force_power_;
    torque_power_ = before.torque_power_;
  }

 private:
  double memory_s_;
  bool with_torque_;
  double force_power_ = 0.0, torque_power_ = 0.0;  // running mean squares
};

}  // namespace odmc
