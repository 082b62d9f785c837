#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

#include "odmc/model/motor.h"
#include "odmc/model/vehicle.h"

namespace odmc {

/// A simulated vehicle's ESCs: throttles on their way to the motors. Each acts after its motor's
/// delay, wherever within a step that falls, and drives the motor at the present voltage. What acts
/// is told as the speed it holds, which is what MotorLag follows. Times in seconds on any one
/// clock.
class MotorDrive {
 public:
  /// @throws std::invalid_argument if the actuator does not fit `num_rotors`
  MotorDrive(const Actuator& actuator, int num_rotors);

  /// Throttles that have acted for ever (n×1).
  void Start(const RotorVector& throttle);

  /// Throttles from `time_s` on (n×1), limited to 0 to 1.
  void Command(double time_s, const RotorVector& throttle);

  /// The newest command, as limited (n×1).
  const RotorVector& throttle() const { return newest_; }

  /// Speeds that what acts at present holds at this voltage (n×1, rad/s).
  RotorVector SteadySpeeds(double voltage_V) const;

  /// Throttles that hold these speeds (n×1, rad/s), limited to 0 to 1; 0 for a speed of 0 or less.
  RotorVector ThrottleFor(const RotorVector& speed, double voltage_V) const;

  /// What every rotor reaches at full throttle [rad/s].
  double MaxSpeed(double voltage_V) const;

  /// Cuts [time_s, time_s + step_s) where commands begin to act.
  /// @param move called as move(time_s, steady_speeds, piece_s) for one piece after the other
  template <typename Move>
  void Advance(double time_s, double step_s, double voltage_V, const Move& move) {
    const double end_s = time_s + step_s;
    for (double at_s = time_s; at_s < end_s;) {
      ActUntil(at_s);
      const double next_s = std::min(NextChange(), end_s);
      // The whole step as it was given, where nothing cuts it.
      const bool is_whole = at_s == time_s && next_s == end_s;
      move(at_s, SteadySpeeds(voltage_V), is_whole ? step_s : next_s - at_s);
      at_s = next_s;
    }
    ActUntil(end_s);
  }

 private:
  struct Pending {
    double time_s, throttle;
  };
  struct Esc {
    std::vector<Pending> pending;  // commands that do not act yet, oldest first
    double acting = 0.0;           // throttle
  };
  // When the next command begins to act; infinity without one.
  double NextChange() const;
  void ActUntil(double time_s);

  Actuator actuator_;
  std::vector<Esc> escs_;
  RotorVector newest_;
};

}  // namespace odmc
