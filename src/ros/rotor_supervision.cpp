#include "odmc/ros/rotor_supervision.h"

#include <ros/console.h>

namespace odmc {
namespace {

constexpr double kCommandsLost_s = 0.5;  // RotorSource then watches no longer

}  // namespace

RotorSupervision::RotorSupervision(const Actuator* actuator, int num_rotors, bool from_commands) {
  if (actuator == nullptr) return;
  source_.emplace(*actuator, num_rotors, from_commands);
  uses_voltage_ = actuator->uses_voltage;
}

void RotorSupervision::FindVoltage(const std::vector<Sample>& samples) {
  if (!source_ || has_voltage_) return;
  for (const Sample& sample : samples) {
    const auto* battery = std::get_if<BatterySample>(&sample);
    if (battery == nullptr || !(battery->voltage_V > 0.0)) continue;
    source_->Add(*battery);
    has_voltage_ = true;
    return;
  }
}

void RotorSupervision::Add(const BatterySample& sample) {
  if (source_) source_->Add(sample);
}

std::optional<RotorSample> RotorSupervision::Add(const CommandSample& sample) {
  if (!source_) return std::nullopt;
  last_command_ = sample.stamp;
  return source_->Add(sample);
}

std::optional<RotorSample> RotorSupervision::Add(const RotorSample& sample, bool rms_only) {
  if (!source_ || rms_only) return sample;
  has_commands_ = last_command_ && ToSeconds(sample.stamp - *last_command_) < kCommandsLost_s;
  std::optional<RotorSample> settled = source_->Add(sample);
  TellFaults();
  return settled;
}

void RotorSupervision::Restart() {
  if (source_) source_->Restart();
  last_command_.reset();
}

void RotorSupervision::TellFaults() {
  for (const RotorFault& fault : source_->TakeFaults()) {
    ROS_WARN("%s from %.3f s: %s%s", RotorName(fault.rotor).c_str(), ToSeconds(fault.stamp),
             fault.reason.c_str(), fault.failed ? "; speeds from its commands stand in" : "");
    if (fault.failed) {
      ++faults_;
      bad_[fault.rotor] = fault;
    } else {
      bad_.erase(fault.rotor);
    }
  }
}

RotorStatus RotorSupervision::Now(bool rms_only) const {
  RotorStatus status;
  status.from_commands = source_->from_commands();
  const bool has_drive = has_voltage_ || !uses_voltage_;
  status.is_watching = !status.from_commands && has_commands_ && has_drive && !rms_only;
  for (const auto& [rotor, fault] : bad_) status.bad.push_back(fault);
  status.replaced = source_->replaced();
  status.faults = faults_;
  return status;
}

}  // namespace odmc
