#pragma once

#include <limits>
#include <vector>

#include "odmc/model/motor.h"

namespace odmc {

/// One rotor's speed from its commands and the battery voltage alone, as they come. A command holds
/// until the next one and acts after the motor's delay. Times in seconds on any one clock; they
/// must not step back. Thread-compatible.
class SpeedPredictor {
 public:
  explicit SpeedPredictor(const Motor& motor) : motor_(motor) {}

  /// @param voltage_V as the motor's map takes it
  void Command(double t_s, double throttle, double voltage_V);
  /// Speed at `t_s`: free from the last start on. Before the first one it is that of a rotor which
  /// has followed its command for long; 0 without a command.
  double At(double t_s);
  /// Starts anew from a known speed, as after a hole in the stream.
  void StartAt(double t_s, double speed);
  /// Speed that the command which acts at present holds.
  double Steady() const { return motor_.dynamics.SteadySpeed(drive_); }
  /// Time for which At() was last asked, or the start; minus infinity before.
  double time_s() const { return t_s_; }
  void Forget();

 private:
  struct Pending {
    double t_s, drive;
  };
  void ActUntil(double t_s);

  Motor motor_;
  std::vector<Pending> pending_;  // commands that do not act yet, oldest first from next_ on
  size_t next_ = 0;
  double throttle_ = 0.0, voltage_V_ = 0.0, newest_drive_ = 0.0;  // of the newest command
  double drive_ = 0.0;                                            // acts at t_s_
  double t_s_ = -std::numeric_limits<double>::infinity(), speed_ = 0.0;
  bool has_command_ = false, started_ = false;
};

}  // namespace odmc
