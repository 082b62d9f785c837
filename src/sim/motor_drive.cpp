#include "odmc/sim/motor_drive.h"

#include <limits>
#include <stdexcept>
#include <string>

namespace odmc {
namespace {

constexpr size_t kRoom = 256;            // commands on their way before memory is asked for
constexpr double kSameInstant_s = 1e-9;  // stamps are whole nanoseconds

}  // namespace

MotorDrive::MotorDrive(const Actuator& actuator, int num_rotors)
    : actuator_(actuator),
      escs_(static_cast<size_t>(num_rotors)),
      newest_(RotorVector::Zero(num_rotors)) {
  if (!actuator.Fits(num_rotors)) {
    throw std::invalid_argument("the actuator has " + std::to_string(actuator.motors.size()) +
                                " motors, the vehicle " + std::to_string(num_rotors) + " rotors");
  }
  for (Esc& esc : escs_) esc.pending.reserve(kRoom);
}

void MotorDrive::Start(const RotorVector& throttle) {
  newest_ = throttle.cwiseMax(0.0).cwiseMin(1.0);
  for (int j = 0; j < newest_.size(); ++j) {
    Esc& esc = escs_[static_cast<size_t>(j)];
    esc.pending.clear();
    esc.acting = newest_[j];
  }
}

void MotorDrive::Command(double time_s, const RotorVector& throttle) {
  newest_ = throttle.cwiseMax(0.0).cwiseMin(1.0);
  for (int j = 0; j < newest_.size(); ++j) {
    // A delay that came out negative of a bench's time stamps is none.
    const double delay_s = std::max(0.0, actuator_.MotorOf(j).delay_s);
    escs_[static_cast<size_t>(j)].pending.push_back({time_s + delay_s, newest_[j]});
  }
  ActUntil(time_s);
}

void MotorDrive::ActUntil(double time_s) {
  for (Esc& esc : escs_) {
    auto next = esc.pending.begin();
    for (; next != esc.pending.end() && next->time_s <= time_s + kSameInstant_s; ++next)
      esc.acting = next->throttle;
    esc.pending.erase(esc.pending.begin(), next);
  }
}

double MotorDrive::NextChange() const {
  double next_s = std::numeric_limits<double>::infinity();
  for (const Esc& esc : escs_) {
    if (!esc.pending.empty()) next_s = std::min(next_s, esc.pending.front().time_s);
  }
  return next_s;
}

RotorVector MotorDrive::SteadySpeeds(double voltage_V) const {
  RotorVector speed(newest_.size());
  const double map_V = actuator_.MapVoltage(voltage_V);
  for (int j = 0; j < speed.size(); ++j)
    speed[j] = actuator_.MotorOf(j).SteadySpeed(escs_[static_cast<size_t>(j)].acting, map_V);
  return speed;
}

RotorVector MotorDrive::ThrottleFor(const RotorVector& speed, double voltage_V) const {
  RotorVector throttle = RotorVector::Zero(speed.size());
  const double map_V = actuator_.MapVoltage(voltage_V);
  for (int j = 0; j < speed.size(); ++j) {
    if (speed[j] > 0.0) throttle[j] = actuator_.MotorOf(j).ThrottleFor(speed[j], 0.0, map_V);
  }
  return throttle;
}

double MotorDrive::MaxSpeed(double voltage_V) const {
  double slowest = std::numeric_limits<double>::infinity();
  const double map_V = actuator_.MapVoltage(voltage_V);
  for (const Motor& motor : actuator_.motors)
    slowest = std::min(slowest, motor.SteadySpeed(1.0, map_V));
  return slowest;
}

}  // namespace odmc
