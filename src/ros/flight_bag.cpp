#include "odmc/ros/flight_bag.h"

#include <nav_msgs/Odometry.h>
#include <rosbag/bag.h>
#include <rosbag/view.h>
#include <sensor_msgs/BatteryState.h>
#include <sensor_msgs/Imu.h>
#include <std_msgs/Int64.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <limits>
#include <memory>
#include <new>
#include <set>
#include <stdexcept>
#include <utility>
#include <vector>

#include "bag_structure.h"
#include "child_reader.h"
#include "odmc/MotorCommands.h"
#include "odmc/RotorSpeeds.h"
#include "odmc/io/data_sets.h"
#include "odmc/ros/message_values.h"
#include "odmc/ros/pose_twist.h"
#include "odmc/ros/tf_odometry.h"
#include "odmc/sensing/flight_checks.h"
#include "odmc/sensing/twist_frame.h"
#include "odmc/text/printable_text.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

constexpr Stamp kSecond = 1000000000;
constexpr char kShiftTopic[] = "/stamp_shift";
constexpr char kWorldFrame[] = "world";

// ---- Stamps and topics -------------------------------------------------------------------------

std::string Join(const std::set<std::string>& names) {
  std::string text;
  for (const std::string& name : names) text += (text.empty() ? "" : ", ") + name;
  return text;
}

/// "/a/b" and "a/b" name the same topic in a bag.
std::string WithSlash(const std::string& topic) {
  return !topic.empty() && topic[0] == '/' ? topic : "/" + topic;
}

bool EndsIn(const std::string& topic, const std::string& role) {
  const std::string name = WithSlash(topic), end = "/" + role;
  return name.size() >= end.size() && name.compare(name.size() - end.size(), end.size(), end) == 0;
}

/// An open bag with its topics and the way they serve the roles.
class BagSource {
 public:
  BagSource(const std::string& file, const BagOptions& options);

  const std::string& file() const { return file_; }
  rosbag::Bag& bag() { return bag_; }

  /// Topic of a role; empty where the bag has none.
  std::string TopicOf(const std::string& role) const;

  /// Shows what every message of a topic says to `use`, in the order of recording.
  /// @param num_rotors  0: as many as a message has
  template <typename Input, typename Use>
  void Read(const std::string& topic, InputStream stream, int num_rotors, FlightLog* log, Use use);

  /// Type of a topic; empty where the bag has none of this name.
  std::string TypeOf(const std::string& topic) const {
    const auto found = types_.find(topic);
    return found == types_.end() ? "" : found->second;
  }

  /// Shows every message of a topic, with the layout of its type, to `use`.
  template <typename Use>
  void ReadRaw(const std::string& topic, Use use);

  /// Poses of one frame in another, from all messages of tf.
  std::vector<OdometryInput> ReadTf(const std::string& parent, const std::string& child,
                                    FlightLog* log);

  /// Number of messages of a topic.
  size_t Count(const std::string& topic) {
    return rosbag::View(bag_, rosbag::TopicQuery(topic)).size();
  }

  /// Types of all topics, for errors.
  std::string Contents() const;

 private:
  void CheckMap() const;
  std::set<std::string> KnownTopics(ForeignUse use) const;
  std::string OneOf(const std::set<std::string>& topics, const std::string& role) const;
  std::string TfTopic(InputStream stream) const;
  void AddTf(InputStream stream, TfOdometry* tf, std::vector<OdometryInput>* poses);

  std::string file_;
  const BagOptions& options_;
  rosbag::Bag bag_;
  std::map<std::string, std::string> types_;  // by topic
};

BagSource::BagSource(const std::string& file, const BagOptions& options)
    : file_(file), options_(options) {
  try {
    bag_.open(file, rosbag::bagmode::Read);
  } catch (const rosbag::BagUnindexedException&) {
    RefuseFile(file,
               "has no index: recording was cut off or the file is truncated; "
               "`rosbag reindex` rescues what is there");
  } catch (const rosbag::BagException& e) {
    RefuseFile(file, std::string("is not a bag or truncated: ") + e.what());
  }
  rosbag::View view(bag_);
  for (const rosbag::ConnectionInfo* info : view.getConnections()) {
    types_[info->topic] = info->datatype;
  }
  CheckMap();
}

std::string BagSource::Contents() const {
  std::set<std::string> topics;
  for (const auto& [topic, type] : types_) topics.insert(topic + " (" + type + ")");
  return topics.empty() ? "the bag is empty" : "the bag has " + Join(topics);
}

void BagSource::CheckMap() const {
  for (const auto& [name, topic] : options_.topics) {
    const auto role = std::find_if(StreamRoles().begin(), StreamRoles().end(),
                                   [&, key = name](const StreamRole& r) { return r.name == key; });
    if (role == StreamRoles().end()) {
      std::set<std::string> known;
      for (const StreamRole& r : StreamRoles()) known.insert(r.name);
      RefuseFile(file_, "unknown topic role '" + name + "'; known are: " + Join(known));
    }
    const std::string found = TopicOf(name), type = types_.at(found);
    if (!role->foreign && std::count(role->types.begin(), role->types.end(), type) == 0) {
      RefuseFile(file_, "topic " + found + " is a " + type + ", but " + name + " must be a " +
                            role->types.front());
    }
  }
}

std::string BagSource::TopicOf(const std::string& name) const {
  const auto mapped = options_.topics.find(name);
  if (mapped != options_.topics.end()) {
    for (const auto& [topic, type] : types_) {
      if (WithSlash(topic) == WithSlash(mapped->second)) return topic;
    }
    RefuseFile(file_, "has no topic " + mapped->second + " for " + name + "; " + Contents());
  }
  for (const StreamRole& role : StreamRoles()) {
    if (role.name != name) continue;
    for (const std::string& wanted : role.types) {
      std::set<std::string> topics;
      for (const auto& [topic, type] : types_) {
        if (type == wanted) topics.insert(topic);
      }
      if (!topics.empty()) return OneOf(topics, name);
    }
    if (role.foreign) return OneOf(KnownTopics(*role.foreign), name);
  }
  return "";
}

/// Topics whose type says what they hold.
std::set<std::string> BagSource::KnownTopics(ForeignUse use) const {
  std::set<std::string> topics;
  for (const auto& [topic, type] : types_) {
    const KnownMessage* known = FindKnown(use, type);
    if (known == nullptr || known->by_name_only) continue;
    const bool is_command = topic.find("command") != std::string::npos ||
                            topic.find("cmd") != std::string::npos ||
                            topic.find("setpoint") != std::string::npos;
    if (use != ForeignUse::kRotorSpeeds || !is_command) topics.insert(topic);
  }
  return topics;
}

/// The only one of `topics`, or the only one that is named after the role; empty if there is none.
std::string BagSource::OneOf(const std::set<std::string>& topics, const std::string& role) const {
  std::set<std::string> named;
  for (const std::string& topic : topics) {
    if (EndsIn(topic, role)) named.insert(topic);
  }
  const std::set<std::string>& candidates = named.empty() ? topics : named;
  if (candidates.empty()) return "";
  if (candidates.size() > 1) {
    RefuseFile(file_, "several topics could be " + role + ": " + Join(candidates) +
                          "; choose with --topic " + role + ":=" + *candidates.begin());
  }
  return *candidates.begin();
}

template <typename Input, typename Use>
void BagSource::Read(const std::string& topic, InputStream stream, int num_rotors, FlightLog* log,
                     Use use) {
  const std::string source = file_ + ": " + topic;
  Refusals passed_over;
  long number = 0;
  try {
    StreamReader reader(stream, options_, num_rotors);
    rosbag::View view(bag_, rosbag::TopicQuery(topic));
    for (const rosbag::MessageInstance& instance : view) {
      const auto message = instance.instantiate<RawMessage>();
      if (message == nullptr) continue;
      std::optional<InputSample> input = reader.Read(*message, FromRos(instance.getTime()));
      if (input) {
        use(std::get<Input>(*input));
      } else {
        passed_over.Add("message " + std::to_string(number));
      }
      ++number;
    }
    for (const std::string& note : reader.TakeNotes()) {
      log->warnings.push_back(source + ": " + note);
    }
    const bool are_named =
        stream == InputStream::kRotorSpeeds && !options_.rotor_stamp_field.empty();
    if (are_named) log->warnings.push_back(source + ": stamps are " + reader.stamp_source());
  } catch (const std::invalid_argument& e) {
    RefuseFile(file_, "topic " + topic + ": " + e.what());
  }
  if (passed_over.count > 1) {
    passed_over.Report(source, "messages without an entry, or whose entries are not of one time",
                       log);
  }
}

template <typename Use>
void BagSource::ReadRaw(const std::string& topic, Use use) {
  try {
    std::optional<MessageLayout> layout;
    rosbag::View view(bag_, rosbag::TopicQuery(topic));
    for (const rosbag::MessageInstance& instance : view) {
      const auto message = instance.instantiate<RawMessage>();
      if (message == nullptr) continue;
      if (!layout) layout.emplace(message->type(), message->definition());
      use(*layout, *message);
    }
  } catch (const std::invalid_argument& e) {
    RefuseFile(file_, "topic " + topic + ": " + e.what());
  }
}

/// By the name: both topics of tf have the same type.
std::string BagSource::TfTopic(InputStream stream) const {
  const StreamRole& role = RoleOf(stream);
  if (options_.topics.count(role.name) > 0) return TopicOf(role.name);
  std::set<std::string> topics;
  for (const auto& [topic, type] : types_) {
    if (std::count(role.types.begin(), role.types.end(), type) > 0 && EndsIn(topic, role.name)) {
      topics.insert(topic);
    }
  }
  return OneOf(topics, role.name);
}

void BagSource::AddTf(InputStream stream, TfOdometry* tf, std::vector<OdometryInput>* poses) {
  const std::string topic = TfTopic(stream);
  if (topic.empty()) return;
  try {
    rosbag::View view(bag_, rosbag::TopicQuery(topic));
    for (const rosbag::MessageInstance& instance : view) {
      const auto message = instance.instantiate<RawMessage>();
      if (message == nullptr) continue;
      for (OdometryInput& pose : tf->Read(*message, stream)) poses->push_back(std::move(pose));
    }
  } catch (const std::invalid_argument& e) {
    RefuseFile(file_, "topic " + topic + ": " + e.what());
  }
}

std::vector<OdometryInput> BagSource::ReadTf(const std::string& parent, const std::string& child,
                                             FlightLog* log) {
  TfOdometry tf(parent, child);
  std::vector<OdometryInput> poses;
  AddTf(InputStream::kStaticTf, &tf, &poses);  // whenever they were recorded, they hold always
  AddTf(InputStream::kTf, &tf, &poses);
  if (poses.empty()) RefuseFile(file_, tf.Describe());
  if (tf.unmatched() > 0) {
    log->dropped += tf.unmatched();
    log->warnings.push_back(file_ + ": tf: " + std::to_string(tf.unmatched()) + " poses of " +
                            child + " dropped: the way to " + parent +
                            " has a hole at their stamps");
  }
  return poses;
}

// ---- Messages to samples -----------------------------------------------------------------------

/// Drops samples that `is_finite` refuses, and those whose header carries no stamp.
template <typename Sample, typename Test>
void KeepFinite(const std::string& source, std::vector<Sample>* samples, Test is_finite,
                FlightLog* log) {
  Refusals not_finite, no_stamp;
  std::vector<Sample> kept;
  kept.reserve(samples->size());
  for (const Sample& sample : *samples) {
    if (sample.stamp == 0) {
      no_stamp.Add("message " + std::to_string(&sample - samples->data()));
    } else if (!is_finite(sample)) {
      not_finite.Add("message " + std::to_string(&sample - samples->data()));
    } else {
      kept.push_back(sample);
    }
  }
  no_stamp.Report(source, "messages whose header has no stamp", log);
  not_finite.Report(source, "messages that are not finite", log);
  *samples = std::move(kept);
}

/// Messages before the frame of their twist is known.
using RawOdometries = std::vector<OdometryInput>;

/// Sources that know no twist leave zeros, without a mark: a vehicle that moved shows it.
bool IsLinearFilled(const RawOdometries& messages) {
  double path = 0.0;
  for (const OdometryInput& m : messages) {
    if (!m.linear) continue;
    if (*m.linear != Eigen::Vector3d::Zero()) return true;
    path = std::max(path, (m.sample.p_WS - messages.front().sample.p_WS).norm());
  }
  return path < 0.1;
}

bool IsAngularFilled(const RawOdometries& messages) {
  double turn = 0.0;
  for (const OdometryInput& m : messages) {
    if (!m.sample.w_WS_S) continue;
    if (*m.sample.w_WS_S != Eigen::Vector3d::Zero()) return true;
    turn = std::max(turn, m.sample.q_WS.angularDistance(messages.front().sample.q_WS));
  }
  return turn < 0.1;
}

/// The frame of the linear twist: as told, or found from the motion.
TwistFrame FindTwistFrame(const std::string& source, const RawOdometries& messages,
                          const std::string& wanted, FlightLog* log) {
  if (wanted == "body") return TwistFrame::kBody;
  if (wanted == "world") return TwistFrame::kWorld;
  TwistFrameDetector detector;
  for (const OdometryInput& m : messages) {
    if (!m.linear) continue;
    detector.AddSample(m.sample.stamp, m.sample.p_WS, m.sample.q_WS.normalized(), *m.linear);
    if (detector.decided()) break;
  }
  const TwistFrameDecision& decision = detector.decision();
  if (decision.frame == TwistFrame::kNeither) {
    RefuseFile(source, "the twist fits neither frame: " + decision.Describe() +
                           "; state twist_frame if the position is at fault");
  }
  const TwistFrame frame =
      ResolveTwistFrame(decision.frame, messages.front().frame_id, messages.front().child_frame_id);
  if (decision.frame == TwistFrame::kUndecided && decision.moving_s > 1.0) {
    log->warnings.push_back(source +
                            ": the motion does not tell the frame of the twist, took the " +
                            (frame == TwistFrame::kWorld ? "world" : "body") +
                            " frame, as the message says: " + decision.Describe());
  }
  return frame;
}

bool IsFinite(const OdometrySample& s) {
  return s.p_WS.allFinite() && s.q_WS.coeffs().allFinite() && (!s.v_WS || s.v_WS->allFinite()) &&
         (!s.w_WS_S || s.w_WS_S->allFinite());
}

/// Puts samples in order and makes them sound.
void FinishOdometry(const std::string& source, std::vector<OdometrySample>* samples,
                    FlightLog* log) {
  KeepFinite(source, samples, IsFinite, log);
  KeepForward(source, samples, log);
  NormaliseAttitudes(source, samples, log);
  if (samples->empty()) RefuseFile(source, "no usable message");
}

/// Samples with the velocity in the world, in order and sound.
std::vector<OdometrySample> SamplesOf(const std::string& source, const RawOdometries& messages,
                                      const BagOptions& options, FlightLog* log) {
  const bool has_linear = IsLinearFilled(messages), has_angular = IsAngularFilled(messages);
  if (!has_linear) log->warnings.push_back(source + ": linear twist is all zero, not used");
  if (!has_angular) log->warnings.push_back(source + ": angular twist is all zero, not used");
  const TwistFrame frame =
      has_linear ? FindTwistFrame(source, messages, options.twist_frame, log) : TwistFrame::kBody;
  std::vector<OdometrySample> samples;
  samples.reserve(messages.size());
  for (const OdometryInput& m : messages) {
    OdometrySample sample = m.sample;
    if (has_linear && m.linear) {
      const bool is_world = frame == TwistFrame::kWorld;
      sample.v_WS = is_world ? *m.linear : sample.q_WS.normalized() * *m.linear;
    }
    if (!has_angular) sample.w_WS_S.reset();
    samples.push_back(sample);
  }
  FinishOdometry(source, &samples, log);
  return samples;
}

std::vector<OdometrySample> ReadOdometry(BagSource* bag, const std::string& topic,
                                         const BagOptions& options, FlightLog* log) {
  RawOdometries messages;
  messages.reserve(bag->Count(topic));
  bag->Read<OdometryInput>(topic, InputStream::kOdometry, 0, log,
                           [&](const OdometryInput& m) { messages.push_back(m); });
  const std::string source = bag->file() + ": " + topic;
  if (messages.empty()) RefuseFile(source, "no message");
  return SamplesOf(source, messages, options, log);
}

bool IsOlder(const OdometryInput& a, const OdometryInput& b) {
  return a.sample.stamp < b.sample.stamp;
}

/// Poses with the velocities of a topic of twists, where the user names one: nobody else knows
/// whether it is of the same source.
std::vector<OdometrySample> WithTwists(BagSource* bag, const std::string& source,
                                       RawOdometries poses, const BagOptions& options,
                                       FlightLog* log) {
  RawOdometries twists, messages;
  const bool has_twists = options.topics.count("twist") > 0;
  if (!has_twists) {
    std::vector<OdometrySample> samples;
    for (const OdometryInput& m : poses) samples.push_back(m.sample);
    FinishOdometry(source, &samples, log);
    return samples;
  }
  bag->Read<OdometryInput>(bag->TopicOf("twist"), InputStream::kTwist, 0, log,
                           [&](const OdometryInput& m) { twists.push_back(m); });
  std::stable_sort(poses.begin(), poses.end(), IsOlder);
  std::stable_sort(twists.begin(), twists.end(), IsOlder);
  PoseTwistPairing pairing(true);
  const auto take = [&messages](const RawOdometries& ready) {
    messages.insert(messages.end(), ready.begin(), ready.end());
  };
  size_t next = 0;
  for (const OdometryInput& pose : poses) {
    while (next < twists.size() && !IsOlder(pose, twists[next])) {
      take(pairing.AddTwist(twists[next++]));
    }
    take(pairing.AddPose(pose));
  }
  for (; next < twists.size(); ++next) take(pairing.AddTwist(twists[next]));
  take(pairing.Flush());
  if (messages.empty()) RefuseFile(source, "no message");
  return SamplesOf(source, messages, options, log);
}

std::vector<OdometrySample> ReadPoses(BagSource* bag, const std::string& topic,
                                      const BagOptions& options, FlightLog* log) {
  RawOdometries poses;
  bag->Read<OdometryInput>(topic, InputStream::kPose, 0, log,
                           [&](const OdometryInput& m) { poses.push_back(m); });
  return WithTwists(bag, bag->file() + ": " + topic, std::move(poses), options, log);
}

/// What tf says of the two frames, where the user names them.
std::vector<OdometrySample> ReadTfPoses(BagSource* bag, const BagOptions& options, FlightLog* log) {
  for (const char* role : {"odometry", "pose"}) {
    if (options.topics.count(role) > 0) {
      RefuseFile(bag->file(), std::string("odometry comes from tf (odometry_tf_child is ") +
                                  options.odometry_tf_child + "): --topic " + role +
                                  " is not read");
    }
  }
  return WithTwists(bag, bag->file() + ": tf",
                    bag->ReadTf(options.odometry_tf_parent, options.odometry_tf_child, log),
                    options, log);
}

bool IsFinite(const ImuSample& s) {
  return (s.gyro_I || s.specific_force_I) && (!s.gyro_I || s.gyro_I->allFinite()) &&
         (!s.specific_force_I || s.specific_force_I->allFinite());
}

void ReadImu(BagSource* bag, FlightLog* log) {
  const std::string topic = bag->TopicOf("imu");
  if (topic.empty()) return;
  bag->Read<ImuInput>(topic, InputStream::kImu, 0, log,
                      [&](const ImuInput& m) { log->imu.push_back(m.sample); });
  const std::string source = bag->file() + ": " + topic;
  KeepFinite(
      source, &log->imu, [](const ImuSample& s) { return IsFinite(s); }, log);
  KeepForward(source, &log->imu, log);
}

void ReadCommands(BagSource* bag, int num_rotors, FlightLog* log) {
  const std::string topic = bag->TopicOf("motor_commands");
  if (topic.empty()) return;
  const std::string source = bag->file() + ": " + topic;
  bag->Read<CommandSample>(topic, InputStream::kMotorCommands, num_rotors, log,
                           [&](const CommandSample& m) { log->commands.push_back(m); });
  KeepFinite(
      source, &log->commands, [](const CommandSample& s) { return s.throttle.allFinite(); }, log);
  KeepForward(source, &log->commands, log);
}

/// Topic and stream of rotor speeds; an empty topic where there are none.
std::pair<std::string, InputStream> FindRotors(BagSource* bag, const BagOptions& options) {
  const bool is_mapped = options.topics.count("rotor_speeds") > 0;
  if (!options.rotor_topic_field.empty() && !is_mapped) {
    RefuseFile(bag->file(), "which topic has the field " + options.rotor_topic_field +
                                "? Say so by --topic rotor_speeds:=/name; " + bag->Contents());
  }
  // A mapped joint_states says which of the two the user means.
  const bool joints_only = options.topics.count("joint_states") > 0;
  const std::string topic = joints_only ? "" : bag->TopicOf("rotor_speeds");
  if (!topic.empty()) return {topic, InputStream::kRotorSpeeds};
  return {bag->TopicOf("joint_states"), InputStream::kJointStates};
}

void ReadRotors(BagSource* bag, int num_rotors, const BagOptions& options, FlightLog* log) {
  const auto [topic, stream] = FindRotors(bag, options);
  const std::string source = bag->file() + ": " + topic;
  if (topic.empty()) {
    if (!log->commands.empty()) return;  // no sensor: commands may stand in
    RefuseFile(
        bag->file(),
        "no rotor speeds (odmc/RotorSpeeds, sensor_msgs/JointState, or a type that is known); "
        "--topic rotor_speeds:=/name and --rotor-topic-field read any other; " +
            bag->Contents());
  }
  bag->Read<RotorInput>(topic, stream, num_rotors, log, [&](const RotorInput& m) {
    log->rotors.push_back(m.sample);
    log->rotor_rms_only = log->rotor_rms_only || m.rms_only;
  });
  KeepFinite(
      source, &log->rotors, [](const RotorSample& s) { return s.speed.allFinite(); }, log);
  KeepForward(source, &log->rotors, log);
  if (log->rotors.empty()) RefuseFile(source, "no usable rotor speeds");
  TakeSpeedMagnitudes(source, log);
  WarnOfDeadRotors(source, log);
}

void ReadBattery(BagSource* bag, FlightLog* log) {
  const std::string topic = bag->TopicOf("battery_state");
  if (topic.empty()) return;
  bag->Read<BatterySample>(topic, InputStream::kBatteryState, 1, log,
                           [&](const BatterySample& m) { log->battery.push_back(m); });
  const std::string source = bag->file() + ": " + topic;
  KeepFinite(
      source, &log->battery, [](const BatterySample& s) { return std::isfinite(s.voltage_V); },
      log);
  KeepForward(source, &log->battery, log);
}

template <typename Sample>
void Shift(Stamp shift, std::vector<Sample>* samples) {
  for (Sample& sample : *samples) sample.stamp += shift;
}

void ShiftAll(Stamp shift, FlightLog* log) {
  Shift(shift, &log->odometry);
  Shift(shift, &log->imu);
  Shift(shift, &log->rotors);
  Shift(shift, &log->battery);
  Shift(shift, &log->commands);
}

/// How far WriteFlightBag() moved the stamps; 0 for other bags.
Stamp ReadShift(BagSource* bag) {
  constexpr Stamp kMost = kSecond * std::numeric_limits<std::uint32_t>::max();  // a ROS stamp
  rosbag::View view(bag->bag(), rosbag::TopicQuery(std::string(kShiftTopic)));
  for (const rosbag::MessageInstance& instance : view) {
    const auto m = instance.instantiate<std_msgs::Int64>();
    if (m == nullptr) continue;
    if (m->data < -kMost || m->data > kMost) {
      RefuseFile(bag->file(),
                 std::string("is damaged: ") + kShiftTopic + " holds no shift of stamps");
    }
    return m->data;
  }
  return 0;
}

// ---- Blackbird's own bags ----------------------------------------------------------------------

constexpr char kBlackbirdState[] = "/blackbird/state", kBlackbirdRotors[] = "/blackbird/rotor_rpm",
               kBlackbirdImu[] = "/blackbird/imu", kBlackbirdPwm[] = "/blackbird/pwm";

/// Poses of the data set are NED, which no type says: its own topic name does.
bool IsBlackbird(const BagSource& bag, const BagOptions& options) {
  return options.topics.empty() && !options.uses_tf() &&
         bag.TypeOf(kBlackbirdState) == "geometry_msgs/PoseStamped";
}

BlackbirdFlight::RotorMessage RotorMessageOf(const std::string& file, const MessageLayout& layout,
                                             const RawMessage& m) {
  BlackbirdFlight::RotorMessage rotors;
  rotors.rpm = layout.Numbers(layout.Find("rpm[]"), m.bytes.data(), m.bytes.size());
  const bool is_stamped = layout.Has("sample_stamp[]");
  rotors.stamps = layout.Stamps(layout.Find(is_stamped ? "sample_stamp[]" : "header.stamp"),
                                m.bytes.data(), m.bytes.size());
  // Messages of the first version, and those whose list is empty, have the header's for all.
  if (is_stamped && rotors.stamps.empty()) {
    rotors.stamps = layout.Stamps(layout.Find("header.stamp"), m.bytes.data(), m.bytes.size());
  }
  if (rotors.stamps.size() == 1) rotors.stamps.resize(rotors.rpm.size(), rotors.stamps.front());
  if (rotors.rpm.empty() || rotors.rpm.size() != rotors.stamps.size()) {
    RefuseFile(file, std::to_string(rotors.stamps.size()) + " stamps for " +
                         std::to_string(rotors.rpm.size()) + " rotor speeds");
  }
  return rotors;
}

FlightLog ReadBlackbirdBag(BagSource* bag, const FlightReadOptions& read) {
  FlightLog log;
  log.file = std::filesystem::path(bag->file()).filename().string();
  for (const char* topic : {kBlackbirdState, kBlackbirdRotors}) {
    if (bag->TypeOf(topic).empty() || bag->Count(topic) == 0) {
      RefuseFile(bag->file(), std::string("no messages on ") + topic + "; " + bag->Contents());
    }
  }
  BlackbirdFlight flight;
  flight.path = bag->file();
  bag->Read<OdometryInput>(
      kBlackbirdState, InputStream::kPose, 0, &log, [&](const OdometryInput& m) {
        const Eigen::Quaterniond& q = m.sample.q_WS;
        flight.poses.push_back({m.sample.stamp, m.sample.p_WS, {q.w(), q.x(), q.y(), q.z()}});
      });
  if (!bag->TypeOf(kBlackbirdImu).empty()) {
    bag->Read<ImuInput>(kBlackbirdImu, InputStream::kImu, 0, &log,
                        [&](const ImuInput& m) { flight.imu.push_back(m.sample); });
  }
  bag->ReadRaw(kBlackbirdRotors, [&](const MessageLayout& layout, const RawMessage& m) {
    flight.rotors.push_back(RotorMessageOf(bag->file(), layout, m));
  });
  bag->ReadRaw(kBlackbirdPwm, [&](const MessageLayout& layout, const RawMessage& m) {
    const auto stamps = layout.Stamps(layout.Find("header.stamp"), m.bytes.data(), m.bytes.size());
    flight.commands.push_back(
        {stamps.front(), layout.Numbers(layout.Find("pwm[]"), m.bytes.data(), m.bytes.size())});
  });
  ConvertBlackbird(std::move(flight), read, &log);
  return log;
}

/// Odometry, or poses where there is none or mocap is wanted; or tf.
void ReadMotion(BagSource* bag, const FlightReadOptions& read, const BagOptions& options,
                FlightLog* log) {
  if (options.uses_tf()) {
    if (read.part != FlightPart::kOnboard) UseMocapPoses(ReadTfPoses(bag, options, log), log);
    return;
  }
  const bool poses_mapped =
      options.topics.count("pose") > 0 && options.topics.count("odometry") == 0;
  const std::string odometry_topic = poses_mapped ? "" : bag->TopicOf("odometry");
  const bool wants_poses = odometry_topic.empty() || read.pose == PoseSource::kMocap;
  const std::string pose_topic = wants_poses ? bag->TopicOf("pose") : "";
  if (wants_poses && pose_topic.empty() && read.part != FlightPart::kOnboard) {
    RefuseFile(
        bag->file(),
        "no odometry (nav_msgs/Odometry or geometry_msgs/PoseStamped, PoseWithCovarianceStamped, "
        "TransformStamped; of tf with --odometry-tf-parent and --odometry-tf-child); " +
            bag->Contents());
  }
  if (!odometry_topic.empty()) log->odometry = ReadOdometry(bag, odometry_topic, options, log);
  if (!pose_topic.empty()) UseMocapPoses(ReadPoses(bag, pose_topic, options, log), log);
}

FlightLog ReadOpenBag(BagSource* bag, const FlightReadOptions& read, const BagOptions& options) {
  if (IsBlackbird(*bag, options)) return ReadBlackbirdBag(bag, read);
  FlightLog log;
  log.file = std::filesystem::path(bag->file()).filename().string();
  if (read.part != FlightPart::kPoses) ReadImu(bag, &log);
  ReadMotion(bag, read, options, &log);
  if (read.part == FlightPart::kPoses) {
    log.imu.clear();
  } else {
    ReadCommands(bag, read.num_rotors, &log);
    ReadRotors(bag, read.num_rotors, options, &log);
    ReadBattery(bag, &log);
  }
  ShiftAll(-ReadShift(bag), &log);
  return log;
}

FlightLog ReadOpenActuatorBag(BagSource* bag, const BagOptions& options) {
  FlightLog log;
  log.file = std::filesystem::path(bag->file()).filename().string();
  const std::string topic = bag->TopicOf("motor_commands");
  if (topic.empty()) RefuseFile(bag->file(), "no odmc/MotorCommands; " + bag->Contents());
  int num_rotors = 0;  // of the first message
  FlightLog unused;
  bag->Read<CommandSample>(topic, InputStream::kMotorCommands, 0, &unused,
                           [&](const CommandSample& m) {
                             if (num_rotors == 0) num_rotors = static_cast<int>(m.throttle.size());
                           });
  if (num_rotors == 0) RefuseFile(bag->file(), topic + " has no message");
  ReadCommands(bag, num_rotors, &log);
  ReadRotors(bag, num_rotors, options, &log);
  if (log.rotors.empty()) RefuseFile(bag->file(), "no rotor speeds; " + bag->Contents());
  ReadBattery(bag, &log);
  return log;
}

/// What reading may cost, from what the bag unpacks to. Messages become samples one by one; the
/// library holds an index entry (64 bytes) for each and one chunk, and strings and arrays of a
/// message are several times larger than their bytes. The slowest computer unpacks bz2 at some
/// megabytes a second.
ChildLimits LimitsFor(std::uint64_t uncompressed_bytes) {
  constexpr std::uint64_t kLeastMemory = 512 << 20, kMemoryRatio = 8;
  constexpr std::uint64_t kLeastTime_s = 10, kBytesPerSecond = 1 << 20;
  return {kLeastMemory + kMemoryRatio * uncompressed_bytes,
          kLeastTime_s + uncompressed_bytes / kBytesPerSecond};
}

void CheckOptions(const std::string& file, const BagOptions& options) {
  try {
    options.Check();
  } catch (const std::invalid_argument& e) {
    RefuseFile(file, e.what());
  }
}

template <typename Read>
FlightLog ReadOpened(const std::string& file, const BagOptions& options, const Read& read) {
  try {
    Restrict(LimitsFor(std::filesystem::file_size(file)));
    Restrict(LimitsFor(CheckBagStructure(file).uncompressed_bytes));
    CheckOptions(file, options);
    BagSource bag(file, options);
    return read(&bag);
  } catch (const std::invalid_argument&) {
    throw;
  } catch (const std::bad_alloc&) {
    RefuseFile(file, "is damaged: a length in it asks for more memory than the whole bag needs");
  } catch (const std::exception& e) {
    // A damaged chunk or record shows as any of a dozen exceptions of rosbag and its libraries.
    RefuseFile(file, std::string("is damaged or truncated: ") + e.what());
  }
}

/// The bag library takes lengths and counts as it finds them: a child process reads.
template <typename Read>
FlightLog WithOpenBag(const std::string& file, const BagOptions& options, const Read& read) {
  if (!std::filesystem::is_regular_file(file)) RefuseFile(file, "cannot be opened");
  FlightLog log = ReadInChild(file, [&] { return ReadOpened(file, options, read); });
  log.file = Printable(log.file);
  for (std::string& warning : log.warnings) warning = Printable(warning);  // names of topics
  return log;
}

FlightLog ReadBag(const std::string& file, const FlightReadOptions& read,
                  const BagOptions& options) {
  if (options.twist_frame != "auto" && options.twist_frame != "body" &&
      options.twist_frame != "world") {
    RefuseFile(file, "twist_frame must be auto, body or world, not '" + options.twist_frame + "'");
  }
  return WithOpenBag(file, options,
                     [&](BagSource* bag) { return ReadOpenBag(bag, read, options); });
}

FlightReadOptions ReadOptions(int num_rotors, PoseSource pose) {
  FlightReadOptions read;
  read.num_rotors = num_rotors;
  read.pose = pose;
  return read;
}

// ---- Samples to messages -----------------------------------------------------------------------

void SetHeader(Stamp stamp, const std::string& frame, std_msgs::Header* header) {
  header->stamp = ToRos(stamp);
  header->frame_id = frame;
}

/// The velocity stays in the world, since turning it into the body would change its last bits; the
/// child_frame_id says so (ResolveTwistFrame()). Body rates are in the odometry's own frame.
nav_msgs::Odometry ToMessage(const OdometrySample& sample, Stamp stamp) {
  nav_msgs::Odometry m;
  SetHeader(stamp, kWorldFrame, &m.header);
  m.child_frame_id = kWorldFrame;
  m.pose.pose.position.x = sample.p_WS.x();
  m.pose.pose.position.y = sample.p_WS.y();
  m.pose.pose.position.z = sample.p_WS.z();
  m.pose.pose.orientation.x = sample.q_WS.x();
  m.pose.pose.orientation.y = sample.q_WS.y();
  m.pose.pose.orientation.z = sample.q_WS.z();
  m.pose.pose.orientation.w = sample.q_WS.w();
  if (sample.v_WS) m.twist.twist.linear = ToVector3(*sample.v_WS);
  if (sample.w_WS_S) m.twist.twist.angular = ToVector3(*sample.w_WS_S);
  if (!sample.v_WS) m.twist.covariance[0] = -1.0;
  if (!sample.w_WS_S) m.twist.covariance[21] = -1.0;
  return m;
}

sensor_msgs::Imu ToMessage(const ImuSample& sample, Stamp stamp) {
  sensor_msgs::Imu m;
  SetHeader(stamp, "imu_link", &m.header);
  m.orientation.w = 1.0;
  m.orientation_covariance[0] = -1.0;
  if (sample.gyro_I) m.angular_velocity = ToVector3(*sample.gyro_I);
  if (sample.specific_force_I) m.linear_acceleration = ToVector3(*sample.specific_force_I);
  if (!sample.gyro_I) m.angular_velocity_covariance[0] = -1.0;
  if (!sample.specific_force_I) m.linear_acceleration_covariance[0] = -1.0;
  return m;
}

odmc::RotorSpeeds ToMessage(const RotorSample& sample, bool rms_only, Stamp stamp) {
  odmc::RotorSpeeds m;
  SetHeader(stamp, "base_link", &m.header);
  m.angular_velocity_rad_s.assign(sample.speed.data(), sample.speed.data() + sample.speed.size());
  m.rms_only = rms_only;
  return m;
}

odmc::MotorCommands ToMessage(const CommandSample& sample, Stamp stamp) {
  odmc::MotorCommands m;
  SetHeader(stamp, "base_link", &m.header);
  m.throttle.assign(sample.throttle.data(), sample.throttle.data() + sample.throttle.size());
  return m;
}

template <typename Sample>
void LowerTo(const std::vector<Sample>& samples, Stamp* earliest) {
  for (const Sample& sample : samples) *earliest = std::min(*earliest, sample.stamp);
}

sensor_msgs::BatteryState ToMessage(const BatterySample& sample, Stamp stamp) {
  constexpr float kUnknown = std::numeric_limits<float>::quiet_NaN();  // as the message asks for
  sensor_msgs::BatteryState m;
  SetHeader(stamp, "base_link", &m.header);
  m.voltage = static_cast<float>(sample.voltage_V);
  m.current = m.charge = m.capacity = m.design_capacity = m.percentage = kUnknown;
  m.present = 1;
  return m;
}

/// Messages in the order of their stamps, whatever the stream: bags play back best so.
class OrderedWriter {
 public:
  explicit OrderedWriter(rosbag::Bag* bag) : bag_(bag) {}

  template <typename Sample, typename Convert>
  void Add(const std::string& topic, const std::vector<Sample>& samples, Stamp shift,
           Convert convert) {
    if (samples.empty()) return;
    const auto write = [this, topic, &samples, shift, convert](size_t i) -> std::optional<Stamp> {
      const Stamp stamp = samples[i].stamp + shift;
      bag_->write(topic, ToRos(stamp), convert(samples[i], stamp));
      if (i + 1 == samples.size()) return std::nullopt;
      return samples[i + 1].stamp + shift;
    };
    streams_.push_back({samples.front().stamp + shift, 0, write});
  }

  void WriteAll() {
    while (true) {
      Stream* earliest = nullptr;  // of those equally early, the one added first
      for (Stream& s : streams_) {
        if (s.stamp && (earliest == nullptr || *s.stamp < *earliest->stamp)) earliest = &s;
      }
      if (earliest == nullptr) return;
      earliest->stamp = earliest->write(earliest->next++);
    }
  }

 private:
  /// One topic: its next message, and what writes that and gives the stamp of the one after.
  struct Stream {
    std::optional<Stamp> stamp;
    size_t next;
    std::function<std::optional<Stamp>(size_t)> write;
  };

  rosbag::Bag* bag_;
  std::vector<Stream> streams_;
};

/// Whole seconds that move every stamp to 1 s or later.
Stamp ShiftFor(const FlightLog& log) {
  Stamp earliest = kSecond;
  LowerTo(log.odometry, &earliest);
  LowerTo(log.imu, &earliest);
  LowerTo(log.rotors, &earliest);
  LowerTo(log.battery, &earliest);
  LowerTo(log.commands, &earliest);
  return (2 * kSecond - 1 - earliest) / kSecond * kSecond;
}

void WriteFlight(const FlightLog& log, rosbag::Bag* bag) {
  const Stamp shift = ShiftFor(log);
  if (shift != 0) {
    std_msgs::Int64 message;
    message.data = shift;
    bag->write(kShiftTopic, ToRos(kSecond), message);
  }
  const auto convert = [](const auto& sample, Stamp stamp) { return ToMessage(sample, stamp); };
  OrderedWriter writer(bag);
  writer.Add("/odometry", log.odometry, shift, convert);
  writer.Add("/imu", log.imu, shift, convert);
  writer.Add("/rotor_speeds", log.rotors, shift, [&](const RotorSample& sample, Stamp stamp) {
    return ToMessage(sample, log.rotor_rms_only, stamp);
  });
  writer.Add("/battery_state", log.battery, shift, convert);
  writer.Add("/motor_commands", log.commands, shift, convert);
  writer.WriteAll();
}

}  // namespace

FlightLog ReadFlightBag(const std::string& file, int num_rotors, const BagOptions& options) {
  return ReadBag(file, ReadOptions(num_rotors, PoseSource::kEkf), options);
}

FlightLog ReadActuatorBag(const std::string& file, const BagOptions& options) {
  return WithOpenBag(file, options,
                     [&](BagSource* bag) { return ReadOpenActuatorBag(bag, options); });
}

FlightReaders AllFlightReaders(const BagOptions& options) {
  FlightReaders readers = FlightReaders::Core();
  readers.Add({"a rosbag (.bag)",
               {".bag"},
               [](std::string_view head) { return head.substr(0, 9) == "#ROSBAG V"; },
               false,
               [options](const std::string& file, const FlightReadOptions& read) {
                 return ReadBag(file, read, options);
               }});
  return readers;
}

FlightLog ReadFlight(const std::string& file, int num_rotors, PoseSource pose,
                     const BagOptions& options) {
  return AllFlightReaders(options).Read(file, ReadOptions(num_rotors, pose));
}

void WriteFlightBag(const FlightLog& log, const std::string& file) {
  auto bag = std::make_unique<rosbag::Bag>();
  try {
    bag->open(file, rosbag::bagmode::Write);
    WriteFlight(log, bag.get());
    bag->close();
  } catch (const rosbag::BagException& e) {
    // Its destructor would try to close it again and end the program: it stays as it is.
    static_cast<void>(bag.release());
    throw std::runtime_error(file + ": cannot be written: " + e.what());
  }
}

}  // namespace odmc
