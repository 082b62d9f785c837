#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "odmc/actuator/speed_predictor.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// A rotor-speed sensor that failed, or is back.
struct RotorFault {
  Stamp stamp = 0;
  int rotor = 0;  ///< from 0
  bool failed = true;
  std::string reason;  ///< "its sensor reads 0.50 times what its commands give"
};

/// Rotor speeds as an estimator uses them: from the sensor, from commands and battery voltage, or
/// both. With a sensor the actuator model watches each rotor: readings that are missed, dead,
/// frozen or far off are replaced by the model's, with the model's sigma. Clock-free: runs the same
/// live and on recordings. Thread-compatible.
class RotorSource {
 public:
  /// @param from_commands true: speeds come from the model alone
  /// @throws std::invalid_argument if the actuator does not fit `num_rotors` or knows no dynamics
  RotorSource(const Actuator& actuator, int num_rotors, bool from_commands);

  bool from_commands() const { return from_commands_; }

  void Add(const BatterySample& sample);
  /// @returns speeds at the command's stamp where they come from commands; else nothing
  std::optional<RotorSample> Add(const CommandSample& sample);
  /// @returns the sample, with what failed replaced; nothing where speeds come from commands, or
  ///   where a sensor is bad and commands stay away
  std::optional<RotorSample> Add(const RotorSample& sample);

  /// Faults that began or ended since the last call.
  std::vector<RotorFault> TakeFaults();
  /// Whether the sensor of this rotor is held to be bad at present.
  bool failed(int rotor) const { return rotors_[static_cast<size_t>(rotor)].failed; }
  /// Single readings that were replaced, of all rotors, without a fault.
  long replaced() const { return replaced_; }

  /// The clock stepped back or the stream has a hole: forgets speeds, keeps what it knows of
  /// faults.
  void Restart();

  // A reading that is off by this share of the model's speed is replaced; a mean over kMean_s that
  // is off by kFault is a fault, one below kSound for kBack_s the end of it. A reading that repeats
  // for kFrozen_s while the model moves by kMoved is frozen.
  static constexpr double kMissed = 0.3, kFault = 0.15, kSound = 0.1, kMean_s = 0.1, kBack_s = 1.0;
  static constexpr double kFrozen_s = 0.2, kMoved = 0.03;

 private:
  struct RotorWatch {
    explicit RotorWatch(const Motor& motor) : predictor(motor) {}
    SpeedPredictor predictor;
    std::optional<double> mean;                            // of measured over predicted, low-passed
    double seen_s = 0.0;                                   // behind it
    double sound_s = 0.0;                                  // since it last was bad
    double held = -1.0;                                    // reading that repeats
    double held_s = 0.0, held_low = 0.0, held_high = 0.0;  // for how long, the model meanwhile
    bool failed = false;
  };
  double MapVoltage() const { return actuator_.MapVoltage(voltage_V_.value_or(0.0)); }
  double Sigma() const;
  bool Watch(double dt, double measured, double predicted, RotorWatch* rotor, std::string* reason);

  Actuator actuator_;
  bool from_commands_;
  std::vector<RotorWatch> rotors_;
  std::optional<double> voltage_V_;
  std::optional<Stamp> start_, last_command_, last_rotor_;
  std::vector<RotorFault> faults_;
  long replaced_ = 0;
};

}  // namespace odmc
