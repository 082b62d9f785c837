#include "odmc/ros/controller_report.h"

#include <cstdint>

#include "odmc/ros/conversions.h"
#include "odmc/ros/diagnostic_values.h"

namespace odmc {
namespace {

using diagnostic_msgs::DiagnosticStatus;

void SetLevel(const ControllerReport& r, long refused_before, DiagnosticStatus* status) {
  const auto set = [status](std::uint8_t level, const std::string& message) {
    status->level = level;
    status->message = message;
  };
  if (r.command.mode == ControlMode::kFailsafe) {
    return set(DiagnosticStatus::ERROR, "failsafe: no odometry, level and sinking");
  }
  if (r.not_finite > 0) {
    return set(DiagnosticStatus::ERROR, "a command was not finite and was not published");
  }
  if (!r.twist_warning.empty()) return set(DiagnosticStatus::WARN, r.twist_warning);
  if (r.has_state && r.imu.received == 0) {
    return set(DiagnosticStatus::WARN, "no IMU: without its rates the vehicle cannot be held");
  }
  if (r.has_actuator && r.has_state && r.battery.received == r.battery.refused) {
    return set(DiagnosticStatus::WARN, "no battery voltage: throttles are for the nominal one");
  }
  if (r.reference_lost) {
    return set(DiagnosticStatus::WARN, "the reference has gone: its last place is held");
  }
  if (r.handover == HandoverState::kRolledBack) {
    return set(DiagnosticStatus::WARN, "rolled back: " + r.last_transition);
  }
  if (r.handover == HandoverState::kHolding && r.command.mode != ControlMode::kIdle) {
    return set(DiagnosticStatus::WARN, "the estimate is stale and held: " + r.last_transition);
  }
  if (RefusedInput(r) > refused_before) {
    return set(DiagnosticStatus::WARN,
               "input refused (not finite, no stamp, wrong number of rotors)");
  }
  if (!r.has_state) return set(DiagnosticStatus::OK, "waiting for odometry");
  if (!r.has_reference) return set(DiagnosticStatus::OK, "waiting for a reference");
  set(DiagnosticStatus::OK, NameOf(r.command.mode) + std::string(", ") + NameOf(r.handover));
}

void PutInput(const std::string& stream, const ControlInput& input, DiagnosticStatus* status) {
  PutValue(stream + "_received", input.received, status);
  PutValue(stream + "_refused", input.refused, status);
}

}  // namespace

long RefusedInput(const ControllerReport& r) {
  return r.odometry.refused + r.imu.refused + r.rotors.refused + r.battery.refused +
         r.references.refused + r.estimates.refused;
}

ControllerStatus ToMessage(const ControllerReport& r, const std::string& body_frame) {
  ControllerStatus m;
  m.header = MakeHeader(r.command.stamp, body_frame);
  m.mode = NameOf(r.command.mode);
  m.handover_state = NameOf(r.handover);
  m.handover_progress = r.progress;
  m.estimate_stamp = ToRos(r.estimate_stamp);
  m.indi = r.command.indi;
  m.tracking_error_m = r.tracking_error_m;
  m.tracking_rmse_m = r.tracking_rmse_m;
  m.collective_thrust_N = r.command.collective_thrust_N;
  m.thrust_change_N = r.command.allocation.thrust_change_N;
  m.roll_pitch_share = r.command.allocation.roll_pitch_share;
  m.yaw_share = r.command.allocation.yaw_share;
  m.last_transition = r.last_transition;
  return m;
}

DiagnosticStatus ControllerDiagnostic(const ControllerReport& r, long refused_before,
                                      const std::string& name) {
  DiagnosticStatus status;
  status.name = name;
  SetLevel(r, refused_before, &status);
  PutValue("mode", NameOf(r.command.mode), &status);
  PutValue("handover", NameOf(r.handover), &status);
  PutValue("handover_progress", r.progress, &status);
  PutValue("uses_estimate", r.uses_estimate, &status);
  PutValue("last_transition", r.last_transition, &status);
  PutValue("estimates_declined", r.estimates_declined, &status);
  PutValue("tracking_error_m", r.tracking_error_m, &status);
  PutValue("tracking_rmse_m", r.tracking_rmse_m, &status);
  PutValue("indi", r.command.indi, &status);
  PutValue("saturated", r.command.allocation.saturated(), &status);
  PutValue("steps", r.steps, &status);
  PutValue("late_steps", r.late_steps, &status);
  PutValue("step_ms_max", r.step_ms_max, &status);
  PutValue("odometry_jumps", r.odometry_jumps, &status);
  PutValue("clock_resets", r.clock_resets, &status);
  PutValue("not_finite_commands", r.not_finite, &status);
  PutInput("odometry", r.odometry, &status);
  PutInput("imu", r.imu, &status);
  PutInput("rotor_speeds", r.rotors, &status);
  if (r.has_actuator) PutInput("battery_state", r.battery, &status);
  PutInput("references", r.references, &status);
  PutInput("estimates", r.estimates, &status);
  return status;
}

}  // namespace odmc
