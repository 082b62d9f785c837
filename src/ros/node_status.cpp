#include "odmc/ros/node_status.h"

#include <cmath>
#include <cstdio>

#include "odmc/ros/diagnostic_values.h"

namespace odmc {
namespace {

using diagnostic_msgs::DiagnosticStatus;

void SetLevel(const NodeStatus& s, DiagnosticStatus* status) {
  const auto set = [status](std::uint8_t level, const std::string& message) {
    status->level = level;
    status->message = message;
  };
  if (!s.fatal.empty()) return set(DiagnosticStatus::ERROR, s.fatal);
  if (s.not_finite > 0) {
    return set(DiagnosticStatus::ERROR, "the estimate was not finite and was not published");
  }
  if (!s.interrupted.empty()) return set(DiagnosticStatus::WARN, s.interrupted);
  if (!s.unphysical.empty()) return set(DiagnosticStatus::WARN, JoinSentences(s.unphysical));
  if (!s.unlike_history.empty())
    return set(DiagnosticStatus::WARN, JoinSentences(s.unlike_history));
  if (!s.contradicted_k_m.empty()) return set(DiagnosticStatus::WARN, s.contradicted_k_m);
  if (s.rotors && !s.rotors->bad.empty()) {
    return set(DiagnosticStatus::WARN, JoinSentences(s.rotors->Sentences()));
  }
  if (!s.warnings.empty()) return set(DiagnosticStatus::WARN, JoinSentences(s.warnings));
  if (!s.waiting_for.empty() && !s.airborne) {
    return set(DiagnosticStatus::OK, "waiting for " + s.waiting_for);
  }
  if (!s.airborne) return set(DiagnosticStatus::OK, "not in free flight: " + s.phase);
  const std::string doing = s.frozen ? "frozen" : "estimating";
  set(DiagnosticStatus::OK, doing + (s.accepted ? ", accepted" : ""));
}

void PutCounters(const NodeStatus& s, DiagnosticStatus* status) {
  PutValue("keyframes", s.counters.keyframes, status);
  PutValue("ground_keyframes", s.counters.ground_keyframes, status);
  PutValue("taken_back_keyframes", s.counters.taken_back, status);
  PutValue("starts_anew", s.counters.starts_anew, status);
  PutValue("vehicle_changes", s.counters.changes, status);
  PutValue("airborne_s", s.counters.airborne_s, status);
  PutValue("on_ground_s", s.counters.on_ground_s, status);
  PutValue("gaps", s.counters.gaps, status);
  PutValue("jumps", s.counters.jumps, status);
  PutValue("chains", s.counters.chains, status);
  PutValue("refused_updates", s.counters.refused_updates, status);
  PutValue("dropped_not_finite", s.stream_counters.not_finite, status);
  PutValue("glitches", s.stream_counters.glitches, status);
  PutValue("dropped_out_of_order", s.stream_counters.out_of_order, status);
  PutValue("dropped_repeated_pose", s.stream_counters.repeated_pose, status);
  PutValue("uncovered_keyframes", s.stream_counters.uncovered, status);
  PutValue("clock_resets", s.clock_resets, status);
  PutValue("dropped_of_old_clock", s.stale, status);
  PutValue("dropped_with_lone_leaps_of_stamps", s.leaps, status);
  PutValue("forgotten_while_standing", s.forgotten, status);
  PutValue("not_finite_estimates", s.not_finite, status);
  PutValue("queued", static_cast<long>(s.queued), status);
}

/// Seconds as in message headers, to the millisecond.
std::string StampText(Stamp stamp) {
  char text[40];
  std::snprintf(text, sizeof text, "%.3f", ToSeconds(stamp));
  return text;
}

}  // namespace

std::string RotorName(int rotor) { return "rotor" + std::to_string(rotor + 1); }

std::vector<std::string> RotorStatus::Sentences() const {
  std::vector<std::string> sentences;
  for (const RotorFault& fault : bad) {
    sentences.push_back(RotorName(fault.rotor) + ": " + fault.reason);
  }
  return sentences;
}

DiagnosticStatus EstimatorDiagnostic(const NodeStatus& s, const std::string& name) {
  DiagnosticStatus status;
  status.name = name;
  status.hardware_id = s.model != nullptr ? s.model->vehicle().name : "";
  SetLevel(s, &status);
  PutValue("waiting_for", s.waiting_for, &status);
  PutValue("interrupted", s.interrupted, &status);
  PutValue("phase", s.phase, &status);
  PutValue("trust", s.trust, &status);
  PutValue("findings", s.findings, &status);
  PutValue("rotor_speeds_late_s", s.rotor_speeds_late_s, &status);
  PutValue("imu_late_s", s.imu_late_s, &status);
  PutValue("airborne", s.airborne, &status);
  PutValue("on_ground", s.has_estimate && !s.airborne, &status);
  PutValue("accepted", s.accepted, &status);
  PutValue("frozen", s.frozen, &status);
  PutValue("not_accepted_because", JoinSentences(s.not_accepted_because), &status);
  PutValue("held_back", JoinSentences(s.held_back), &status);
  PutValue("unobservable", JoinSentences(s.unobservable), &status);
  PutValue("warnings", JoinSentences(s.warnings), &status);
  PutValue("unphysical", JoinSentences(s.unphysical), &status);
  PutValue("unlike_history", JoinSentences(s.unlike_history), &status);
  PutValue("contradicted_k_m", s.contradicted_k_m, &status);
  if (s.rotors) PutValue("bad_rotor_sensors", JoinSentences(s.rotors->Sentences()), &status);
  PutValue("twist_frame", s.twist, &status);
  PutCounters(s, &status);
  PutValue("states_in_window", static_cast<long>(s.states_in_window), &status);
  PutValue("update_ms_median", s.update_ms_median, &status);
  PutValue("update_ms_p99", s.update_ms_p99, &status);
  PutValue("publish_ms_median", s.publish_ms_median, &status);
  PutValue("publish_ms_p99", s.publish_ms_p99, &status);
  PutValue("position_noise_m", s.noise.position_m, &status);
  PutValue("attitude_noise_rad", s.noise.attitude_rad, &status);
  PutValue("velocity_noise_m_s", s.noise.velocity_m_s, &status);
  PutValue("rate_noise_rad_s", s.noise.rate_rad_s, &status);
  PutValue("residual_force_N", s.residual_force_rms_N, &status);
  PutValue("residual_torque_Nm", s.residual_torque_rms_Nm, &status);
  PutValue("battery_voltage_V", s.battery_voltage_V, &status);
  return status;
}

DiagnosticStatus UnexplainedDiagnostic(const NodeStatus& s, const std::string& name) {
  DiagnosticStatus status;
  status.name = name;
  status.level = DiagnosticStatus::OK;
  const std::string added = JoinSentences(s.added_effects);
  const std::string tail = added.empty() ? "" : "; added in flight: " + added;
  if (!s.unexplained) {
    status.message = (s.watches_residual ? "too little flight yet" : "off") + tail;
    return status;
  }
  const ResidualAnalysis& r = *s.unexplained;
  status.message = (r.candidate    ? r.candidate->name + " would explain it"
                    : r.structured ? "structured, no effect of the catalogue explains it"
                                   : "nothing to explain") +
                   tail;
  PutValue("structured_share", r.structured_share, &status);
  PutValue("channel", r.channel, &status);
  PutValue("whiteness_p", r.whiteness_p, &status);
  PutValue("force_rmse_N", r.force_rmse_N.norm() / std::sqrt(3.0), &status);
  PutValue("torque_rmse_Nm", r.torque_rmse_Nm.norm() / std::sqrt(3.0), &status);
  PutValue("candidate", r.candidate ? r.candidate->name : "", &status);
  PutValue("score_nats", r.candidate ? r.candidate->score : 0.0, &status);
  PutValue("explained_share", r.explained_share, &status);
  PutValue("beside", JoinSentences(r.beside), &status);
  PutValue("alternatives", JoinSentences(r.alternatives), &status);
  PutValue("in_a_row", static_cast<long>(r.in_a_row), &status);
  PutValue("flight_s", r.flight_s, &status);
  PutValue("added_effects", added, &status);
  return status;
}

DiagnosticStatus RotorDiagnostic(const RotorStatus& r, const std::string& name) {
  DiagnosticStatus status;
  status.name = name;
  status.level = r.bad.empty() ? DiagnosticStatus::OK : DiagnosticStatus::WARN;
  status.message = !r.bad.empty()
                       ? JoinSentences(r.Sentences()) + "; speeds from its commands stand in"
                   : r.from_commands ? "speeds come from commands"
                   : r.is_watching   ? "sensors agree with commands"
                                     : "no commands or no voltage: sensors are not watched";
  PutValue("rotor_speed_from", r.from_commands ? "commands" : "sensor", &status);
  PutValue("watching", r.is_watching, &status);
  std::vector<std::string> names;
  for (const RotorFault& fault : r.bad) names.push_back(RotorName(fault.rotor));
  PutValue("bad_sensors", JoinSentences(names), &status);
  for (const RotorFault& fault : r.bad) {
    PutValue(RotorName(fault.rotor), fault.reason, &status);
    PutValue(RotorName(fault.rotor) + "_since_s", StampText(fault.stamp), &status);
  }
  PutValue("faults", r.faults, &status);
  PutValue("replaced_readings", r.replaced, &status);
  return status;
}

DiagnosticStatus InputDiagnostic(const std::array<StreamStatus, kNumInputStreams>& streams,
                                 const std::array<StreamStatus, kNumInputStreams>& before,
                                 double seconds, const std::string& name) {
  DiagnosticStatus status;
  status.name = name;
  status.level = DiagnosticStatus::OK;
  status.message = "receiving";
  long received = 0;
  for (int i = 0; i < kNumInputStreams; ++i) {
    const StreamStatus& s = streams[i];
    const std::string stream = NameOf(static_cast<InputStream>(i));
    received += s.received;
    PutValue(stream + "_rate_hz", static_cast<double>(s.received - before[i].received) / seconds,
             &status);
    PutValue(stream + "_received", s.received, &status);
    PutValue(stream + "_refused", s.refused, &status);
    PutValue(stream + "_overflowed", s.overflowed, &status);
    if (s.passed_over > 0) PutValue(stream + "_passed_over", s.passed_over, &status);
    if (!s.refusal.empty()) PutValue(stream + "_refused_because", s.refusal, &status);
    if (!s.stamps.empty()) PutValue(stream + "_stamps", s.stamps, &status);
    if (s.overflowed > before[i].overflowed) {
      status.level = DiagnosticStatus::WARN;
      status.message = stream + ": samples lost, the estimator does not keep up";
    } else if (s.refused > before[i].refused) {
      status.level = DiagnosticStatus::WARN;
      status.message =
          stream + (s.refusal.empty()
                        ? ": samples refused (no stamp, not finite, wrong number of rotors)"
                        : ": " + s.refusal);
    }
  }
  if (received == 0) status.message = "nothing received yet";
  return status;
}

}  // namespace odmc
