#pragma once

#include <geometry_msgs/PoseStamped.h>
#include <nav_msgs/Odometry.h>
#include <sensor_msgs/BatteryState.h>
#include <sensor_msgs/Imu.h>
#include <sensor_msgs/JointState.h>

#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "odmc/MotorCommands.h"
#include "odmc/RotorSpeeds.h"
#include "odmc/io/foreign_messages.h"
#include "odmc/ros/raw_message.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// \file
/// The streams of a flight in ROS: one table of roles and types, and one way from messages to
/// samples, for bags and nodes alike. What a message does not say (the frame of its twist, the
/// mount of its sensor) is kept beside the sample until somebody knows.

/// What a topic is read for.
enum class InputStream {
  kOdometry,
  kPose,
  kImu,
  kRotorSpeeds,
  kJointStates,
  kBatteryState,
  kMotorCommands,
  kTwist,
  kTf,
  kStaticTf,
};
constexpr int kNumInputStreams = 10;

/// One line of the table.
struct StreamRole {
  InputStream stream;
  const char* name;  ///< of the node's topic, and of the role in `--topic ROLE:=/name`
  /// Types read as they are; a bag's topic is looked for by them in this order.
  std::vector<std::string> types;
  /// Messages of other types are read by their definition for this.
  std::optional<ForeignUse> foreign = {};
};

/// The table, in the order of InputStream.
const std::vector<StreamRole>& StreamRoles();
const StreamRole& RoleOf(InputStream stream);
const char* NameOf(InputStream stream);
/// Of transforms: read only where odometry comes from them (tf_odometry.h), and always of the root
/// namespace.
bool IsTf(InputStream stream);

/// How messages are to be read: options of the tools, parameters of the node.
struct StreamOptions {
  /// auto | rad_s | rpm | erpm; auto: as the type says, rad_s for joint_states. odmc/RotorSpeeds
  /// are in rad/s always.
  std::string rotor_speed_unit = "auto";
  int pole_pairs = 7;               ///< for erpm
  std::string rotor_topic_field;    ///< path as esc_status[].rpm; empty: that of the known type
  std::vector<int> rotor_order;     ///< entries, from 1, that are rotor 1, 2, ...; empty: in order
  std::string command_topic_field;  ///< as rotor_topic_field
  std::string command_unit = "auto";  ///< auto | fraction | us | raw16
  std::vector<int> command_order;     ///< as rotor_order
  std::string battery_topic_field;    ///< of the voltage [V]
  /// Path of the stamp of each speed, or of all, as esc_status[].timestamp; empty: header.stamp.
  std::string rotor_stamp_field;
  std::string rotor_stamp_unit = "auto";  ///< s | ms | us | ns; auto: the field is a time of ROS
  /// Frames of the world and of the body or sensor: odometry is what tf says of them. Empty: not.
  std::string odometry_tf_parent, odometry_tf_child;

  bool uses_tf() const { return !odometry_tf_child.empty(); }

  template <typename Visitor>
  void Visit(Visitor* v) {
    v->Field("rotor_speed_unit", &rotor_speed_unit);
    v->Field("pole_pairs", &pole_pairs);
    v->Field("rotor_topic_field", &rotor_topic_field);
    v->Field("rotor_order", &rotor_order);
    v->Field("command_topic_field", &command_topic_field);
    v->Field("command_unit", &command_unit);
    v->Field("command_order", &command_order);
    v->Field("battery_topic_field", &battery_topic_field);
    v->Field("rotor_stamp_field", &rotor_stamp_field);
    v->Field("rotor_stamp_unit", &rotor_stamp_unit);
    v->Field("odometry_tf_parent", &odometry_tf_parent);
    v->Field("odometry_tf_child", &odometry_tf_child);
  }

  /// @param num_rotors  0: not known yet
  /// @throws std::invalid_argument naming key and value
  void Check(int num_rotors = 0) const;
};

/// An odometry or pose message, or a twist without a pose. `sample.v_WS` stays empty: its frame is
/// not known yet.
struct OdometryInput {
  OdometrySample sample;
  std::optional<Eigen::Vector3d> linear;  ///< twist as received [m/s]
  std::string frame_id, child_frame_id;
  bool is_pose = false;  ///< came on the stream of poses
};

struct ImuInput {
  ImuSample sample;
  std::string frame_id;
};

struct RotorInput {
  RotorSample sample;  ///< speeds may carry a sign for the direction of turning
  bool rms_only = false;
  bool from_joints = false;  ///< came on the stream of joint states
};

/// One message of any stream.
using InputSample = std::variant<OdometryInput, ImuInput, RotorInput, BatterySample, CommandSample>;

/// What a message says, sound or not. Covariances of -1 mark missing parts: twist[0] of the
/// velocity, twist[21] of body rates, those of an Imu as in REP-145.
OdometryInput InputOf(const nav_msgs::Odometry& message);
OdometryInput InputOf(const geometry_msgs::PoseStamped& message);
ImuInput InputOf(const sensor_msgs::Imu& message);
BatterySample InputOf(const sensor_msgs::BatteryState& message);
/// @param order  entries, from 1, that are rotor 1, 2, ...; empty: in order
/// @param num_rotors  0: as many as the message has
/// @returns nothing where there is not one speed per rotor
std::optional<RotorInput> InputOf(const RotorSpeeds& message, const std::vector<int>& order,
                                  int num_rotors);
/// As for rotor speeds, of throttles.
std::optional<CommandSample> InputOf(const MotorCommands& message, const std::vector<int>& order,
                                     int num_rotors);

/// Reads the messages of one topic, as InputOf() does: nothing is said about whether their numbers
/// are sound. Thread-compatible.
class StreamReader {
 public:
  /// @param num_rotors  0: as many as the message has
  StreamReader(InputStream stream, const StreamOptions& options, int num_rotors);

  /// @param arrival  when the message came or was recorded
  /// @returns nothing for a message that ForeignStream passes over
  /// @throws std::invalid_argument, a sentence naming type and field, where the message cannot be
  ///   read as this stream or has not one number per rotor
  std::optional<InputSample> Read(const RawMessage& message, Stamp arrival);

  /// Sentences for the user about what was read so far, each once.
  std::vector<std::string> TakeNotes();

  /// What the newest sample's stamp is: "header.stamp", "time of arrival", a field with its clock;
  /// empty before the first.
  const std::string& stamp_source() const { return stamp_source_; }

 private:
  InputSample ReadOwn(const RawMessage& message) const;
  std::optional<InputSample> ReadForeign(const RawMessage& message, Stamp arrival);
  RotorInput JointsOf(const sensor_msgs::JointState& message) const;
  RotorVector PerRotor(const std::vector<double>& entries, const std::vector<int>& order,
                       const char* what) const;
  [[noreturn]] void RefuseCount(size_t count, const std::vector<int>& order,
                                const char* what) const;
  FieldOptions Fields() const;

  const StreamRole& role_;
  const StreamOptions options_;
  const int num_rotors_;
  double joint_scale_;                                                // to rad/s
  boost::shared_ptr<std::map<std::string, std::string>> connection_;  // foreign_ is of this one
  std::string foreign_type_, foreign_md5_;
  std::optional<ForeignStream> foreign_;
  std::vector<std::string> notes_;
  std::string stamp_source_;
};

}  // namespace odmc
