#pragma once

#include <diagnostic_msgs/DiagnosticStatus.h>

#include <array>
#include <chrono>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "odmc/actuator/rotor_source.h"
#include "odmc/attribution/residual_watch.h"
#include "odmc/estimator/estimator.h"
#include "odmc/ros/streams.h"

namespace odmc {

/// How one topic comes in.
struct StreamStatus {
  long received = 0;
  long refused = 0;      ///< not finite, no stamp, wrong number of rotors, unreadable
  long passed_over = 0;  ///< nothing in them yet
  std::string refusal;   ///< why the last one was refused, as far as a sentence says it
  std::string stamps;    ///< what its samples' stamps are: "header.stamp", "time of arrival", ...
  long overflowed = 0;   ///< lost because the queue was full
};

/// Where rotor speeds come from, and which sensors are bad.
struct RotorStatus {
  bool from_commands = false;
  bool is_watching = false;          ///< commands come, so that sensors are compared with them
  std::vector<RotorFault> bad = {};  ///< sensors that are bad at present, with how it began
  long replaced = 0;                 ///< single readings that were replaced, without a fault
  long faults = 0;                   ///< so far

  /// "rotor2: its sensor is frozen at 800 rad/s", a sentence for each bad sensor.
  std::vector<std::string> Sentences() const;
};

/// As users count them: "rotor1" for the first.
std::string RotorName(int rotor);

/// What the estimator thread tells the others.
struct NodeStatus {
  std::string fatal;                    ///< a sentence if nothing is estimated any more; else empty
  std::string waiting_for;              ///< a stream or a condition; empty if running
  std::string interrupted;              ///< why nothing is learned in the air; empty if it is
  std::vector<std::string> warnings;    ///< of the set-up, they stay
  std::vector<std::string> unphysical;  ///< of the newest estimate
  std::vector<std::string> unlike_history;  ///< sentences: what differs from earlier flights
  std::string contradicted_k_m;  ///< a sentence if the flight contradicts the k_m held; else empty
  std::string phase;             ///< of the flight, Name(FlightPhase)
  std::string trust;             ///< in the newest estimate: good, doubtful or bad
  std::string findings;          ///< about streams and estimate, in sentences
  double rotor_speeds_late_s = 0.0, imu_late_s = 0.0;  ///< taken off their stamps
  std::string twist;                                   ///< verdict on the frame of the twist
  std::shared_ptr<const DynamicModel> model;
  bool airborne = false, accepted = false, has_estimate = false;
  bool frozen = false;  ///< by service: nothing more is learned
  std::vector<std::string> not_accepted_because, held_back;
  std::vector<std::string> unobservable;
  std::vector<bool> observable;
  EstimatorCounters counters;
  SynchroniserCounters stream_counters;
  OdometryNoise noise;
  double update_ms_median = 0.0, update_ms_p99 = 0.0;
  double publish_ms_median = 0.0, publish_ms_p99 = 0.0;  ///< from an update to its messages
  double residual_force_rms_N = 0.0, residual_torque_rms_Nm = 0.0, battery_voltage_V = 0.0;
  double time_s = 0.0;
  int states_in_window = 0;
  long forgotten = 0, stale = 0, leaps = 0, clock_resets = 0, not_finite = 0;
  size_t queued = 0;
  std::optional<RotorStatus> rotors;  ///< with a known actuator only
  bool watches_residual = false;
  std::optional<ResidualAnalysis> unexplained;  ///< the newest look
  std::vector<std::string> added_effects;       ///< to the model, in flight
};

/// The estimator's diagnostic: level, one sentence, all numbers.
diagnostic_msgs::DiagnosticStatus EstimatorDiagnostic(const NodeStatus& status,
                                                      const std::string& name);

/// What the model leaves unexplained and what would explain it, as of the newest look.
diagnostic_msgs::DiagnosticStatus UnexplainedDiagnostic(const NodeStatus& status,
                                                        const std::string& name);

/// Where rotor speeds come from; a warning while any rotor's sensor is bad.
diagnostic_msgs::DiagnosticStatus RotorDiagnostic(const RotorStatus& status,
                                                  const std::string& name);

/// The inputs' diagnostic: rate of each stream since the last report and what was lost.
/// @param before the streams at the last report, `seconds` ago
diagnostic_msgs::DiagnosticStatus InputDiagnostic(
    const std::array<StreamStatus, kNumInputStreams>& streams,
    const std::array<StreamStatus, kNumInputStreams>& before, double seconds,
    const std::string& name);

}  // namespace odmc
