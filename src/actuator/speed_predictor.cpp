#include "odmc/actuator/speed_predictor.h"

namespace odmc {

void SpeedPredictor::Command(double t_s, double throttle, double voltage_V) {
  if (has_command_ && throttle == throttle_ && voltage_V == voltage_V_) return;
  throttle_ = throttle;
  voltage_V_ = voltage_V;
  newest_drive_ = motor_.esc.Drive(throttle, voltage_V);
  if (!has_command_) {  // as if it had acted for ever
    has_command_ = true;
    drive_ = newest_drive_;
    if (!started_) speed_ = Steady();
    return;
  }
  if (next_ > 256) {  // those that acted
    pending_.erase(pending_.begin(), pending_.begin() + static_cast<long>(next_));
    next_ = 0;
  }
  pending_.push_back({t_s + motor_.delay_s, newest_drive_});
}

void SpeedPredictor::ActUntil(double t_s) {
  while (next_ < pending_.size() && pending_[next_].t_s <= t_s) {
    const Pending& command = pending_[next_++];
    if (command.t_s > t_s_) {
      speed_ = motor_.dynamics.After(speed_, drive_, command.t_s - t_s_);
      t_s_ = command.t_s;
    }
    drive_ = command.drive;
  }
}

double SpeedPredictor::At(double t_s) {
  if (!has_command_) return 0.0;
  if (!started_) {
    started_ = true;
    t_s_ = t_s;
    speed_ = Steady();
  }
  ActUntil(t_s);
  if (t_s > t_s_) {
    speed_ = motor_.dynamics.After(speed_, drive_, t_s - t_s_);
    t_s_ = t_s;
  }
  return speed_;
}

void SpeedPredictor::StartAt(double t_s, double speed) {
  while (next_ < pending_.size() && pending_[next_].t_s <= t_s) drive_ = pending_[next_++].drive;
  started_ = true;
  t_s_ = t_s;
  speed_ = speed;
}

void SpeedPredictor::Forget() { *this = SpeedPredictor(motor_); }

}  // namespace odmc
