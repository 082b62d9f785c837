#pragma once

#include <diagnostic_msgs/DiagnosticStatus.h>

#include <string>

#include "odmc/ControllerStatus.h"
#include "odmc/control/flatness_controller.h"
#include "odmc/control/parameter_handover.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// How one topic of the controller comes in.
struct ControlInput {
  long received = 0;
  long refused = 0;  ///< not finite, no stamp, from the future, wrong number of rotors
};

/// What a controller node has to say about itself.
struct ControllerReport {
  ControlCommand command;  ///< the newest
  HandoverState handover = HandoverState::kNominal;
  double progress = 1.0;
  Stamp estimate_stamp = 0;  ///< 0: nominal
  double tracking_error_m = 0.0, tracking_rmse_m = 0.0;
  std::string last_transition;
  bool uses_estimate = true;
  bool has_state = false, has_reference = false, reference_lost = false;
  std::string twist_warning;  ///< empty: nothing speaks against the twist's frame
  ControlInput odometry, imu, rotors, battery, references, estimates;
  long estimates_declined = 0;  ///< by the hand-over
  long steps = 0, late_steps = 0, not_finite = 0, odometry_jumps = 0, clock_resets = 0;
  bool has_actuator = false;  ///< throttles are published, at the battery's voltage
  double step_ms_max = 0.0;   ///< wall time since the last report
};

ControllerStatus ToMessage(const ControllerReport& report, const std::string& body_frame);

/// Level, one sentence, all numbers. ERROR in failsafe; WARN where the estimate was rolled back or
/// is held in flight, the reference has gone, or input is refused.
/// @param refused_before all input refused up to the last report
diagnostic_msgs::DiagnosticStatus ControllerDiagnostic(const ControllerReport& report,
                                                       long refused_before,
                                                       const std::string& name);

/// Of all topics.
long RefusedInput(const ControllerReport& report);

}  // namespace odmc
