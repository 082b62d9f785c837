#include "odmc/ros/streams.h"

#include <geometry_msgs/PoseWithCovarianceStamped.h>
#include <geometry_msgs/TransformStamped.h>
#include <geometry_msgs/TwistStamped.h>
#include <geometry_msgs/TwistWithCovarianceStamped.h>

#include <algorithm>
#include <set>
#include <stdexcept>
#include <utility>

#include "odmc/model/motor.h"
#include "odmc/ros/message_values.h"

namespace odmc {
namespace {

constexpr double kMissing = -1.0;  // as a first variance
constexpr char kJointState[] = "sensor_msgs/JointState";

OdometryInput PoseOf(const std_msgs::Header& header, const geometry_msgs::Point& p,
                     const geometry_msgs::Quaternion& q) {
  OdometryInput input;
  input.sample.stamp = FromRos(header.stamp);
  input.sample.p_WS = ToEigen(p);
  input.sample.q_WS = ToEigen(q);
  input.frame_id = header.frame_id;
  return input;
}

OdometryInput PoseInputOf(const RawMessage& raw) {
  OdometryInput input;
  if (raw.type() == "geometry_msgs/PoseStamped") {
    return InputOf(DecodeMessage<geometry_msgs::PoseStamped>(raw));
  } else if (raw.type() == "geometry_msgs/PoseWithCovarianceStamped") {
    const auto m = DecodeMessage<geometry_msgs::PoseWithCovarianceStamped>(raw);
    input = PoseOf(m.header, m.pose.pose.position, m.pose.pose.orientation);
  } else {
    const auto m = DecodeMessage<geometry_msgs::TransformStamped>(raw);
    input = PoseOf(m.header, geometry_msgs::Point(), m.transform.rotation);
    input.sample.p_WS = ToEigen(m.transform.translation);
  }
  input.is_pose = true;
  return input;
}

/// The velocity alone: sources differ in the frame of their body rates.
OdometryInput TwistOf(const std_msgs::Header& header, const geometry_msgs::Vector3& linear) {
  OdometryInput input;
  input.sample.stamp = FromRos(header.stamp);
  input.frame_id = header.frame_id;
  input.linear = ToEigen(linear);
  return input;
}

OdometryInput TwistInputOf(const RawMessage& raw) {
  if (raw.type() == "geometry_msgs/TwistStamped") {
    const auto m = DecodeMessage<geometry_msgs::TwistStamped>(raw);
    return TwistOf(m.header, m.twist.linear);
  }
  const auto m = DecodeMessage<geometry_msgs::TwistWithCovarianceStamped>(raw);
  return TwistOf(m.header, m.twist.twist.linear);
}

void CheckOrder(const char* key, const std::vector<int>& order, int num_rotors) {
  const std::set<int> entries(order.begin(), order.end());
  if (entries.size() < order.size() || (!order.empty() && *entries.begin() < 1)) {
    throw std::invalid_argument(std::string(key) +
                                " must name different entries of the message, from 1");
  }
  if (num_rotors > 0 && !order.empty() && static_cast<int>(order.size()) != num_rotors) {
    throw std::invalid_argument(std::string(key) + " names " + std::to_string(order.size()) +
                                " rotors, the vehicle has " + std::to_string(num_rotors));
  }
}

/// Nothing where there is not one entry per rotor. @param num_rotors  0: any number
std::optional<RotorVector> InOrderOfRotors(const std::vector<double>& entries,
                                           const std::vector<int>& order, int num_rotors) {
  const std::optional<std::vector<double>> ordered = EntriesInOrder(entries, order);
  const size_t size = ordered ? ordered->size() : 0;
  const bool fits = num_rotors > 0 ? size == static_cast<size_t>(num_rotors)
                                   : size >= 1 && size <= static_cast<size_t>(kMaxRotors);
  if (!fits) return std::nullopt;
  return Eigen::Map<const Eigen::VectorXd>(ordered->data(), static_cast<Eigen::Index>(size));
}

}  // namespace

// ---- The table ---------------------------------------------------------------------------------

const std::vector<StreamRole>& StreamRoles() {
  static const std::vector<StreamRole> roles = {
      {InputStream::kOdometry, "odometry", {"nav_msgs/Odometry"}},
      {InputStream::kPose,
       "pose",
       {"geometry_msgs/PoseStamped", "geometry_msgs/PoseWithCovarianceStamped",
        "geometry_msgs/TransformStamped"}},
      {InputStream::kImu, "imu", {"sensor_msgs/Imu"}},
      {InputStream::kRotorSpeeds, "rotor_speeds", {"odmc/RotorSpeeds"}, ForeignUse::kRotorSpeeds},
      {InputStream::kJointStates, "joint_states", {kJointState}},
      {InputStream::kBatteryState,
       "battery_state",
       {"sensor_msgs/BatteryState"},
       ForeignUse::kVoltage},
      {InputStream::kMotorCommands,
       "motor_commands",
       {"odmc/MotorCommands"},
       ForeignUse::kCommands},
      {InputStream::kTwist,
       "twist",
       {"geometry_msgs/TwistStamped", "geometry_msgs/TwistWithCovarianceStamped"}},
      {InputStream::kTf, "tf", {"tf2_msgs/TFMessage", "tf/tfMessage"}},
      {InputStream::kStaticTf, "tf_static", {"tf2_msgs/TFMessage", "tf/tfMessage"}},
  };
  return roles;
}

const StreamRole& RoleOf(InputStream stream) { return StreamRoles()[static_cast<size_t>(stream)]; }

const char* NameOf(InputStream stream) { return RoleOf(stream).name; }

bool IsTf(InputStream stream) {
  return stream == InputStream::kTf || stream == InputStream::kStaticTf;
}

void StreamOptions::Check(int num_rotors) const {
  RotorSpeedScale(rotor_speed_unit, pole_pairs);
  if (command_unit != "auto" && !CommandUnitNamed(command_unit)) {
    throw std::invalid_argument("command_unit must be auto, fraction, us or raw16, not '" +
                                command_unit + "'");
  }
  StampScale(rotor_stamp_unit);
  if (odometry_tf_parent.empty() != odometry_tf_child.empty()) {
    throw std::invalid_argument(
        std::string(odometry_tf_parent.empty() ? "odometry_tf_parent" : "odometry_tf_child") +
        " is missing: odometry from tf needs the frame of the world (parent) and of the body "
        "(child)");
  }
  if (uses_tf() && odometry_tf_parent == odometry_tf_child) {
    throw std::invalid_argument("odometry_tf_parent and odometry_tf_child are the same frame, " +
                                odometry_tf_child);
  }
  CheckOrder("rotor_order", rotor_order, num_rotors);
  CheckOrder("command_order", command_order, num_rotors);
}

// ---- Messages of their own classes -------------------------------------------------------------

OdometryInput InputOf(const nav_msgs::Odometry& m) {
  OdometryInput input = PoseOf(m.header, m.pose.pose.position, m.pose.pose.orientation);
  input.child_frame_id = m.child_frame_id;
  if (m.twist.covariance[0] != kMissing) input.linear = ToEigen(m.twist.twist.linear);
  if (m.twist.covariance[21] != kMissing) input.sample.w_WS_S = ToEigen(m.twist.twist.angular);
  return input;
}

OdometryInput InputOf(const geometry_msgs::PoseStamped& m) {
  OdometryInput input = PoseOf(m.header, m.pose.position, m.pose.orientation);
  input.is_pose = true;
  return input;
}

ImuInput InputOf(const sensor_msgs::Imu& m) {
  ImuInput input;
  input.sample.stamp = FromRos(m.header.stamp);
  input.frame_id = m.header.frame_id;
  if (m.angular_velocity_covariance[0] != kMissing) {
    input.sample.gyro_I = ToEigen(m.angular_velocity);
  }
  if (m.linear_acceleration_covariance[0] != kMissing) {
    input.sample.specific_force_I = ToEigen(m.linear_acceleration);
  }
  return input;
}

BatterySample InputOf(const sensor_msgs::BatteryState& m) {
  return {FromRos(m.header.stamp), FromFloat(m.voltage)};
}

std::optional<RotorInput> InputOf(const RotorSpeeds& m, const std::vector<int>& order,
                                  int num_rotors) {
  const auto speeds = InOrderOfRotors(m.angular_velocity_rad_s, order, num_rotors);
  if (!speeds) return std::nullopt;
  RotorInput input;
  input.sample.stamp = FromRos(m.header.stamp);
  input.sample.speed = *speeds;
  input.rms_only = m.rms_only;
  return input;
}

std::optional<CommandSample> InputOf(const MotorCommands& m, const std::vector<int>& order,
                                     int num_rotors) {
  const auto throttle = InOrderOfRotors(m.throttle, order, num_rotors);
  if (!throttle) return std::nullopt;
  return CommandSample{FromRos(m.header.stamp), *throttle};
}

// ---- Messages of any type ----------------------------------------------------------------------

StreamReader::StreamReader(InputStream stream, const StreamOptions& options, int num_rotors)
    : role_(RoleOf(stream)),
      options_(options),
      num_rotors_(num_rotors),
      joint_scale_(RotorSpeedScale(options.rotor_speed_unit, options.pole_pairs)) {}

std::optional<InputSample> StreamReader::Read(const RawMessage& message, Stamp arrival) {
  const auto& types = role_.types;
  const std::string& type = message.type();
  const bool are_joints = role_.stream == InputStream::kRotorSpeeds && type == kJointState;
  const bool is_own = are_joints || std::count(types.begin(), types.end(), type) > 0;
  const bool is_told = !Fields().field.empty();  // then the field counts, whatever the type
  if (role_.foreign && (is_told || !is_own)) return ReadForeign(message, arrival);
  if (!is_own) {
    throw std::invalid_argument("is a " + type + ", but " + role_.name + " must be a " + types[0]);
  }
  if (role_.stream == InputStream::kRotorSpeeds && !options_.rotor_stamp_field.empty()) {
    throw std::invalid_argument("is a " + type + ", whose header has the stamp: " +
                                "rotor_stamp_field is for messages of other packages");
  }
  stamp_source_ = "header.stamp";
  return ReadOwn(message);
}

InputSample StreamReader::ReadOwn(const RawMessage& message) const {
  switch (role_.stream) {
    case InputStream::kOdometry:
      return InputOf(DecodeMessage<nav_msgs::Odometry>(message));
    case InputStream::kPose:
      return PoseInputOf(message);
    case InputStream::kTwist:
      return TwistInputOf(message);
    case InputStream::kImu:
      return InputOf(DecodeMessage<sensor_msgs::Imu>(message));
    case InputStream::kBatteryState:
      return InputOf(DecodeMessage<sensor_msgs::BatteryState>(message));
    case InputStream::kMotorCommands: {
      const auto m = DecodeMessage<MotorCommands>(message);
      const auto input = InputOf(m, options_.command_order, num_rotors_);
      if (!input) RefuseCount(m.throttle.size(), options_.command_order, "commands");
      return *input;
    }
    default:
      break;
  }
  if (message.type() == kJointState) {
    return JointsOf(DecodeMessage<sensor_msgs::JointState>(message));
  }
  const auto m = DecodeMessage<RotorSpeeds>(message);
  const auto input = InputOf(m, options_.rotor_order, num_rotors_);
  if (!input) RefuseCount(m.angular_velocity_rad_s.size(), options_.rotor_order, "speeds");
  return *input;
}

FieldOptions StreamReader::Fields() const {
  switch (role_.stream) {
    case InputStream::kRotorSpeeds:
      return {options_.rotor_topic_field, options_.rotor_speed_unit,  options_.pole_pairs,
              options_.rotor_order,       options_.rotor_stamp_field, options_.rotor_stamp_unit};
    case InputStream::kMotorCommands:
      return {options_.command_topic_field, options_.command_unit, options_.pole_pairs,
              options_.command_order};
    case InputStream::kBatteryState:
      return {options_.battery_topic_field, "auto", 1, {}};
    default:
      return {};
  }
}

std::optional<InputSample> StreamReader::ReadForeign(const RawMessage& message, Stamp arrival) {
  const bool is_same = connection_ != nullptr && connection_ == message.connection;
  const bool is_alike = message.type() == foreign_type_ && message.md5() == foreign_md5_;
  if (!foreign_ || (!is_same && !is_alike)) {
    foreign_.emplace(*role_.foreign,
                     MessageDescription{message.type(), message.md5(), message.definition()},
                     Fields(), num_rotors_);
    foreign_type_ = message.type();
    foreign_md5_ = message.md5();
  }
  connection_ = message.connection;
  const std::optional<ForeignReading> reading =
      foreign_->Read(message.bytes.data(), message.bytes.size(), arrival);
  for (std::string& note : foreign_->TakeNotes()) notes_.push_back(std::move(note));
  if (reading) stamp_source_ = foreign_->StampSource();
  if (!reading) return std::nullopt;
  switch (*role_.foreign) {
    case ForeignUse::kVoltage:
      return BatterySample{reading->stamp, reading->values.front()};
    case ForeignUse::kCommands:
      return CommandSample{reading->stamp, PerRotor(reading->values, {}, "commands")};
    default:
      break;
  }
  RotorInput input;
  input.sample.stamp = reading->stamp;
  input.sample.speed = PerRotor(reading->values, {}, "speeds");
  return input;
}

std::vector<std::string> StreamReader::TakeNotes() { return std::exchange(notes_, {}); }

RotorInput StreamReader::JointsOf(const sensor_msgs::JointState& m) const {
  RotorInput input;
  input.sample.stamp = FromRos(m.header.stamp);
  input.sample.speed = joint_scale_ * PerRotor(SpeedsOfJoints(m), options_.rotor_order, "speeds");
  input.from_joints = role_.stream == InputStream::kJointStates;
  return input;
}

RotorVector StreamReader::PerRotor(const std::vector<double>& entries,
                                   const std::vector<int>& order, const char* what) const {
  const std::optional<RotorVector> ordered = InOrderOfRotors(entries, order, num_rotors_);
  if (!ordered) RefuseCount(entries.size(), order, what);
  return *ordered;
}

void StreamReader::RefuseCount(size_t count, const std::vector<int>& order,
                               const char* what) const {
  const std::string has = "has " + std::to_string(count) + " " + what;
  throw std::invalid_argument(
      !order.empty()    ? has + ", an order of " + std::to_string(order.size()) + " was given"
      : num_rotors_ > 0 ? has + ", the vehicle has " + std::to_string(num_rotors_) + " rotors"
                        : has);
}

}  // namespace odmc
