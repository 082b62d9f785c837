#pragma once

#include <map>
#include <optional>
#include <vector>

#include "odmc/actuator/rotor_source.h"
#include "odmc/ros/node_status.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// Watches rotor speeds by the commands, where the actuator is known, puts speeds from commands in
/// the place of a bad sensor's, and keeps book of it. Without a known actuator it lets all pass.
/// Thread-compatible.
class RotorSupervision {
 public:
  /// @param actuator of which the dynamics are known; null: none
  RotorSupervision(const Actuator* actuator, int num_rotors, bool from_commands);

  bool is_on() const { return source_.has_value(); }
  bool from_commands() const { return source_ && source_->from_commands(); }

  /// Takes the first voltage for those before it, too, as in recorded flights.
  void FindVoltage(const std::vector<Sample>& samples);
  void Add(const BatterySample& sample);
  /// @returns speeds by the commands, where they are what is used
  std::optional<RotorSample> Add(const CommandSample& sample);
  /// @param rms_only root mean squares of all rotors: of them no single one can be told to be bad
  /// @returns the speeds to use; nothing where none are to be used
  std::optional<RotorSample> Add(const RotorSample& sample, bool rms_only);
  /// The clock stepped back.
  void Restart();

  /// @pre is_on()
  RotorStatus Now(bool rms_only) const;

 private:
  void TellFaults();

  std::optional<RotorSource> source_;
  bool uses_voltage_ = false;
  bool has_voltage_ = false, has_commands_ = false;
  std::optional<Stamp> last_command_;
  std::map<int, RotorFault> bad_;  // by rotor
  long faults_ = 0;
};

}  // namespace odmc
