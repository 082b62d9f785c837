#include "odmc/ros/conversions.h"

#include <cmath>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "odmc/sensing/plausible.h"

namespace odmc {
namespace {

constexpr double kLeastThrottle = -0.2, kMostThrottle = 1.2;  // ESCs may be told 800 to 2200 us

std::optional<OdometryInput> AcceptedAs(OdometryInput input) {
  OdometrySample moving = input.sample;
  moving.v_WS = input.linear;  // in whichever frame
  if (input.sample.stamp <= 0 || !IsPlausible(moving)) return std::nullopt;
  input.sample.q_WS.normalize();
  return input;
}

std::optional<ImuInput> AcceptedAs(ImuInput input) {
  const bool has_any = input.sample.gyro_I || input.sample.specific_force_I;
  if (input.sample.stamp <= 0 || !has_any || !IsPlausible(input.sample)) return std::nullopt;
  return input;
}

std::optional<RotorInput> AcceptedAs(RotorInput input) {
  input.sample.speed = input.sample.speed.cwiseAbs().eval();
  if (input.sample.stamp <= 0 || !IsPlausible(input.sample)) return std::nullopt;
  return input;
}

std::optional<BatterySample> AcceptedAs(BatterySample sample) {
  if (sample.stamp <= 0 || !std::isfinite(sample.voltage_V)) return std::nullopt;
  return sample;
}

std::optional<CommandSample> AcceptedAs(CommandSample sample) {
  if (sample.stamp <= 0 || !sample.throttle.allFinite()) return std::nullopt;
  if (sample.throttle.minCoeff() < kLeastThrottle || sample.throttle.maxCoeff() > kMostThrottle) {
    return std::nullopt;
  }
  return sample;
}

}  // namespace

DynamicParameter ToMessage(const ParameterEstimate& p) {
  DynamicParameter m;
  m.name = p.full_name;
  m.value = p.value;
  m.sigma = p.sigma;
  m.unit = p.unit;
  m.state = p.estimated ? DynamicParameter::ESTIMATED : DynamicParameter::FROZEN;
  m.observable = p.observable;
  return m;
}

// ---- Messages to samples -----------------------------------------------------------------------

std::optional<InputSample> AcceptedInput(InputSample input) {
  return std::visit(
      [](auto& one) -> std::optional<InputSample> {
        auto accepted = AcceptedAs(std::move(one));
        if (!accepted) return std::nullopt;
        return InputSample(*std::move(accepted));
      },
      input);
}

std::optional<OdometryInput> ToInput(const nav_msgs::Odometry& message) {
  return AcceptedAs(InputOf(message));
}

std::optional<ImuInput> ToInput(const sensor_msgs::Imu& message) {
  return AcceptedAs(InputOf(message));
}

std::optional<BatterySample> ToInput(const sensor_msgs::BatteryState& message) {
  return AcceptedAs(InputOf(message));
}

std::optional<RotorInput> ToInput(const RotorSpeeds& message, int num_rotors) {
  auto input = InputOf(message, {}, num_rotors);
  return input ? AcceptedAs(*std::move(input)) : std::nullopt;
}

std::optional<CommandSample> ToInput(const MotorCommands& message, int num_rotors) {
  auto input = InputOf(message, {}, num_rotors);
  return input ? AcceptedAs(*std::move(input)) : std::nullopt;
}

geometry_msgs::TransformStamped ToTransform(Stamp stamp, const std::string& parent,
                                            const std::string& child, const Eigen::Vector3d& p,
                                            const Eigen::Matrix3d& R) {
  geometry_msgs::TransformStamped m;
  m.header = MakeHeader(stamp, parent);
  m.child_frame_id = child;
  m.transform.translation = ToVector3(p);
  m.transform.rotation = ToQuaternion(Eigen::Quaterniond(R).normalized());
  return m;
}

}  // namespace odmc
