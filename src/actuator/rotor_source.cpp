#include "odmc/actuator/rotor_source.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "odmc/text/format.h"

namespace odmc {
namespace {

constexpr double kTurning_rad_s = 20.0;  // slower ones may rightly read anything
constexpr double kLongestStep_s = 0.5;   // a longer hole starts anew

}  // namespace

RotorSource::RotorSource(const Actuator& actuator, int num_rotors, bool from_commands)
    : actuator_(actuator), from_commands_(from_commands) {
  const auto motors = static_cast<int>(actuator.motors.size());
  if (motors != 1 && motors != num_rotors) {
    throw std::invalid_argument("the actuator has " + std::to_string(motors) +
                                " motors, the vehicle " + std::to_string(num_rotors) + " rotors");
  }
  if (!actuator.knows_dynamics) {
    throw std::invalid_argument(
        "the actuator comes from steady readings and knows no dynamics; it can't give speeds in "
        "flight");
  }
  for (int j = 0; j < num_rotors; ++j) rotors_.emplace_back(actuator.MotorOf(j));
}

double RotorSource::Sigma() const {
  // Flight is neither all steady nor all response.
  return std::sqrt(0.5 * (std::pow(actuator_.sigma_steady_rad_s, 2) +
                          std::pow(actuator_.sigma_response_rad_s, 2)));
}

void RotorSource::Restart() {
  start_.reset();
  last_command_.reset();
  last_rotor_.reset();
  for (RotorWatch& rotor : rotors_) {
    rotor.predictor.Forget();
    rotor.held = -1.0;
    rotor.sound_s = 0.0;
  }
}

void RotorSource::Add(const BatterySample& sample) {
  if (std::isfinite(sample.voltage_V) && sample.voltage_V > 0.0) voltage_V_ = sample.voltage_V;
}

std::optional<RotorSample> RotorSource::Add(const CommandSample& sample) {
  if (!sample.throttle.allFinite() || sample.throttle.size() != static_cast<long>(rotors_.size()))
    return std::nullopt;
  if (actuator_.uses_voltage && !voltage_V_) return std::nullopt;  // no drive is known yet
  if (last_command_ && sample.stamp <= *last_command_) return std::nullopt;
  if (last_command_ && ToSeconds(sample.stamp - *last_command_) > kLongestStep_s) Restart();
  last_command_ = sample.stamp;
  if (!start_) start_ = sample.stamp;
  const double t_s = ToSeconds(sample.stamp - *start_);
  RotorSample modelled;
  modelled.stamp = sample.stamp;
  modelled.speed.resize(sample.throttle.size());
  for (size_t j = 0; j < rotors_.size(); ++j) {
    const auto k = static_cast<Eigen::Index>(j);
    rotors_[j].predictor.Command(t_s, sample.throttle[k], MapVoltage());
    if (from_commands_) modelled.speed[k] = rotors_[j].predictor.At(t_s);
  }
  if (!from_commands_) return std::nullopt;
  modelled.model_sigma = RotorVector::Constant(sample.throttle.size(), Sigma());
  return modelled;
}

// Updates what is known of one sensor. @returns whether this reading may be used
bool RotorSource::Watch(double dt, double measured, double predicted, RotorWatch* rotor,
                        std::string* reason) {
  if (predicted < kTurning_rad_s) {
    rotor->held = -1.0;
    return !rotor->failed;
  }
  if (measured != rotor->held) {
    rotor->held = measured;
    rotor->held_s = 0.0;
    rotor->held_low = rotor->held_high = predicted;
  } else {
    rotor->held_s += dt;
    rotor->held_low = std::min(rotor->held_low, predicted);
    rotor->held_high = std::max(rotor->held_high, predicted);
  }
  const bool frozen =
      rotor->held_s >= kFrozen_s && rotor->held_high - rotor->held_low > kMoved * predicted;
  const double ratio = measured / predicted;
  if (!rotor->mean) rotor->mean = 1.0;  // a first reading while it spins up shows nothing
  rotor->seen_s += dt;
  *rotor->mean += std::min(1.0, dt / kMean_s) * (ratio - *rotor->mean);
  const double off = std::abs(*rotor->mean - 1.0);
  const bool far_off = off > kFault && rotor->seen_s >= kMean_s;
  rotor->sound_s = frozen || off > kSound ? 0.0 : rotor->sound_s + dt;
  if (!rotor->failed && (frozen || far_off)) {
    rotor->failed = true;
    // The mean lags behind: the reading itself says more, unless it happens to be right.
    const double shown = std::abs(ratio - 1.0) > kFault ? ratio : *rotor->mean;
    *reason = frozen         ? Format("its sensor is frozen at %.0f rad/s", measured)
              : shown < 0.02 ? std::string("its sensor reads 0")
                             : Format("its sensor reads %.2f times what its commands give", shown);
  } else if (rotor->failed && rotor->sound_s >= kBack_s) {
    rotor->failed = false;
    *reason = "its sensor agrees with its commands again";
  }
  return !rotor->failed && std::abs(ratio - 1.0) <= kMissed;
}

std::optional<RotorSample> RotorSource::Add(const RotorSample& sample) {
  if (from_commands_) return std::nullopt;
  if (!start_ || sample.stamp < *start_ ||
      sample.speed.size() != static_cast<long>(rotors_.size()) || !sample.speed.allFinite())
    return sample;  // no command yet; what is wrong with it others say
  const double t_s = ToSeconds(sample.stamp - *start_);
  if (last_rotor_ && sample.stamp <= *last_rotor_) return sample;
  const double dt = last_rotor_ ? ToSeconds(sample.stamp - *last_rotor_) : 0.0;
  last_rotor_ = sample.stamp;
  if (ToSeconds(sample.stamp - *last_command_) > kLongestStep_s) {
    // Without commands there is no model: a bad sensor can't be replaced, and must not be believed.
    const bool bad = std::any_of(rotors_.begin(), rotors_.end(),
                                 [](const RotorWatch& rotor) { return rotor.failed; });
    return bad ? std::nullopt : std::make_optional(sample);
  }
  RotorSample used = sample;
  for (size_t j = 0; j < rotors_.size(); ++j) {
    const auto k = static_cast<Eigen::Index>(j);
    const double predicted = rotors_[j].predictor.At(t_s);
    const bool was_failed = rotors_[j].failed;
    std::string reason;
    const bool usable =
        Watch(std::min(dt, kLongestStep_s), sample.speed[k], predicted, &rotors_[j], &reason);
    if (!reason.empty())
      faults_.push_back({sample.stamp, static_cast<int>(j), rotors_[j].failed, reason});
    if (usable) continue;
    if (used.model_sigma.size() == 0)
      used.model_sigma = RotorVector::Zero(static_cast<Eigen::Index>(rotors_.size()));
    used.speed[k] = predicted;
    used.model_sigma[k] = Sigma();
    if (!was_failed && !rotors_[j].failed) ++replaced_;
  }
  return used;
}

std::vector<RotorFault> RotorSource::TakeFaults() { return std::exchange(faults_, {}); }

}  // namespace odmc
