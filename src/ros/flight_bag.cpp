#include "odmc/ros/flight_bag.h"

#include <geometry_msgs/PoseStamped.h>
#include <nav_msgs/Odometry.h>
#include <rosbag/bag.h>
#include <rosbag/view.h>
#include <sensor_msgs/BatteryState.h>
#include <sensor_msgs/Imu.h>
#include <sensor_msgs/JointState.h>
#include <std_msgs/Int64.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <limits>
#include <set>
#include <new>
#include <stdexcept>
#include <utility>
#include <vector>

#include "bag_structure.h"
#include "child_reader.h"
#include "odmc/MotorCommands.h"
#include "odmc/RotorSpeeds.h"
#include "odmc/io/printable_text.h"
#include "odmc/ros/message_values.h"
#include "odmc/sensing/flight_checks.h"
#include "odmc/sensing/twist_frame.h"

namespace odmc {
namespace {

constexpr Stamp kSecond = 1000000000;
constexpr char kShiftTopic[] = "/stamp_shift";
constexpr char kWorldFrame[] = "world";

[[noreturn]] void Fail(const std::string& file, const std::string& what) {
  throw std::invalid_argument(file + ": " + what);
}

// ---- Stamps and topics -------------------------------------------------------------------------

struct Role {
  std::string name;
  std::string type;  ///< message type as bags name it
};

const std::vector<Role>& Roles() {
  static const std::vector<Role> roles = {{"odometry", "nav_msgs/Odometry"},
                                          {"pose", "geometry_msgs/PoseStamped"},
                                          {"imu", "sensor_msgs/Imu"},
                                          {"rotor_speeds", "odmc/RotorSpeeds"},
                                          {"joint_states", "sensor_msgs/JointState"},
                                          {"battery_state", "sensor_msgs/BatteryState"},
                                          {"motor_commands", "odmc/MotorCommands"}};
  return roles;
}

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

  /// Shows every message of a topic to `use`, in the order of recording.
  template <typename Message, typename Use>
  void Read(const std::string& topic, Use use);

  /// Number of messages of a topic.
  size_t Count(const std::string& topic) {
    return rosbag::View(bag_, rosbag::TopicQuery(topic)).size();
  }

  /// Types of all topics, for errors.
  std::string Contents() const;

 private:
  void CheckMap() const;

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
    Fail(file,
         "has no index: recording was cut off or the file is truncated; "
         "`rosbag reindex` rescues what is there");
  } catch (const rosbag::BagException& e) {
    Fail(file, std::string("is not a bag or truncated: ") + e.what());
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
    const auto role = std::find_if(Roles().begin(), Roles().end(),
                                   [&, key = name](const Role& r) { return r.name == key; });
    if (role == Roles().end()) {
      std::set<std::string> known;
      for (const Role& r : Roles()) known.insert(r.name);
      Fail(file_, "unknown topic role '" + name + "'; known are: " + Join(known));
    }
    const std::string found = TopicOf(name);
    if (types_.at(found) != role->type) {
      Fail(file_, "topic " + found + " is a " + types_.at(found) + ", but " + name + " must be a " +
                      role->type);
    }
  }
}

std::string BagSource::TopicOf(const std::string& role) const {
  const auto mapped = options_.topics.find(role);
  if (mapped != options_.topics.end()) {
    for (const auto& [topic, type] : types_) {
      if (WithSlash(topic) == WithSlash(mapped->second)) return topic;
    }
    Fail(file_, "has no topic " + mapped->second + " for " + role + "; " + Contents());
  }
  std::set<std::string> fitting, named;
  for (const Role& r : Roles()) {
    for (const auto& [topic, type] : types_) {
      if (r.name != role || type != r.type) continue;
      fitting.insert(topic);
      if (EndsIn(topic, role)) named.insert(topic);
    }
  }
  const std::set<std::string>& candidates = named.empty() ? fitting : named;
  if (candidates.empty()) return "";
  if (candidates.size() > 1) {
    Fail(file_, "several topics could be " + role + ": " + Join(candidates) +
                    "; choose with --topic " + role + ":=" + *candidates.begin());
  }
  return *candidates.begin();
}

template <typename Message, typename Use>
void BagSource::Read(const std::string& topic, Use use) {
  rosbag::View view(bag_, rosbag::TopicQuery(topic));
  for (const rosbag::MessageInstance& instance : view) {
    const auto message = instance.instantiate<Message>();
    if (message == nullptr) {
      Fail(file_, "topic " + topic + " holds another version of " + types_.at(topic) +
                      " (its definition differs)");
    }
    use(*message);
  }
}

// ---- Messages to samples -----------------------------------------------------------------------

OdometrySample PoseSample(const std_msgs::Header& header, const geometry_msgs::Pose& pose) {
  OdometrySample sample;
  sample.stamp = FromRos(header.stamp);
  sample.p_WS = ToEigen(pose.position);
  sample.q_WS = ToEigen(pose.orientation);
  return sample;
}

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

/// An odometry message before the frame of its twist is known; a twist that its covariance marks as
/// absent (-1 as the first variance, as REP-145 has it for IMUs) is none.
struct RawOdometry {
  OdometrySample pose;
  std::optional<Eigen::Vector3d> linear, angular;
};

RawOdometry RawOf(const nav_msgs::Odometry& m) {
  RawOdometry raw{PoseSample(m.header, m.pose.pose), {}, {}};
  if (m.twist.covariance[0] != -1.0) raw.linear = ToEigen(m.twist.twist.linear);
  if (m.twist.covariance[21] != -1.0) raw.angular = ToEigen(m.twist.twist.angular);
  return raw;
}

using RawOdometries = std::vector<RawOdometry>;

/// Sources that know no twist leave zeros, without a mark: a vehicle that moved shows it.
bool IsLinearFilled(const RawOdometries& messages) {
  double path = 0.0;
  for (const RawOdometry& m : messages) {
    if (!m.linear) continue;
    if (*m.linear != Eigen::Vector3d::Zero()) return true;
    path = std::max(path, (m.pose.p_WS - messages.front().pose.p_WS).norm());
  }
  return path < 0.1;
}

bool IsAngularFilled(const RawOdometries& messages) {
  double turn = 0.0;
  for (const RawOdometry& m : messages) {
    if (!m.angular) continue;
    if (*m.angular != Eigen::Vector3d::Zero()) return true;
    turn = std::max(turn, m.pose.q_WS.angularDistance(messages.front().pose.q_WS));
  }
  return turn < 0.1;
}

/// The frame of the linear twist: as told, or found from the motion.
/// @param frame_id, child_frame_id of the first message
TwistFrame FindTwistFrame(const std::string& source, const RawOdometries& messages,
                          const std::string& frame_id, const std::string& child_frame_id,
                          const std::string& wanted, FlightLog* log) {
  if (wanted == "body") return TwistFrame::kBody;
  if (wanted == "world") return TwistFrame::kWorld;
  TwistFrameDetector detector;
  for (const RawOdometry& m : messages) {
    if (!m.linear) continue;
    detector.AddSample(m.pose.stamp, m.pose.p_WS, m.pose.q_WS.normalized(), *m.linear);
    if (detector.decided()) break;
  }
  const TwistFrameDecision& decision = detector.decision();
  if (decision.frame == TwistFrame::kNeither) {
    Fail(source, "the twist fits neither frame: " + decision.Describe() +
                     "; state twist_frame if the position is at fault");
  }
  const TwistFrame frame = ResolveTwistFrame(decision.frame, frame_id, child_frame_id);
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
  if (samples->empty()) Fail(source, "no usable message");
}

std::vector<OdometrySample> ReadOdometry(BagSource* bag, const std::string& topic,
                                         const BagOptions& options, FlightLog* log) {
  const std::string source = bag->file() + ": " + topic;
  RawOdometries messages;
  std::string frame_id, child_frame_id;
  messages.reserve(bag->Count(topic));
  bag->Read<nav_msgs::Odometry>(topic, [&](const nav_msgs::Odometry& m) {
    if (messages.empty()) frame_id = m.header.frame_id;
    if (messages.empty()) child_frame_id = m.child_frame_id;
    messages.push_back(RawOf(m));
  });
  if (messages.empty()) Fail(source, "no message");
  const bool has_linear = IsLinearFilled(messages), has_angular = IsAngularFilled(messages);
  if (!has_linear) log->warnings.push_back(source + ": linear twist is all zero, not used");
  if (!has_angular) log->warnings.push_back(source + ": angular twist is all zero, not used");
  const TwistFrame frame =
      has_linear ? FindTwistFrame(source, messages, frame_id, child_frame_id, options.twist_frame,
                                  log)
                 : TwistFrame::kBody;
  std::vector<OdometrySample> samples;
  samples.reserve(messages.size());
  for (const RawOdometry& m : messages) {
    OdometrySample sample = m.pose;
    if (has_linear && m.linear) {
      const bool is_world = frame == TwistFrame::kWorld;
      sample.v_WS = is_world ? *m.linear : sample.q_WS.normalized() * *m.linear;
    }
    if (has_angular) sample.w_WS_S = m.angular;
    samples.push_back(sample);
  }
  FinishOdometry(source, &samples, log);
  return samples;
}

std::vector<OdometrySample> ReadPoses(BagSource* bag, const std::string& topic, FlightLog* log) {
  std::vector<OdometrySample> samples;
  bag->Read<geometry_msgs::PoseStamped>(topic, [&](const geometry_msgs::PoseStamped& m) {
    samples.push_back(PoseSample(m.header, m.pose));
  });
  FinishOdometry(bag->file() + ": " + topic, &samples, log);
  return samples;
}

bool IsFinite(const ImuSample& s) {
  return (s.gyro_I || s.specific_force_I) && (!s.gyro_I || s.gyro_I->allFinite()) &&
         (!s.specific_force_I || s.specific_force_I->allFinite());
}

void ReadImu(BagSource* bag, FlightLog* log) {
  const std::string topic = bag->TopicOf("imu");
  if (topic.empty()) return;
  bag->Read<sensor_msgs::Imu>(topic, [&](const sensor_msgs::Imu& m) {
    ImuSample sample;
    sample.stamp = FromRos(m.header.stamp);
    // REP-145: -1 as the first variance says that the sensor has no such part.
    if (m.angular_velocity_covariance[0] != -1.0) sample.gyro_I = ToEigen(m.angular_velocity);
    if (m.linear_acceleration_covariance[0] != -1.0) {
      sample.specific_force_I = ToEigen(m.linear_acceleration);
    }
    log->imu.push_back(sample);
  });
  const std::string source = bag->file() + ": " + topic;
  KeepFinite(
      source, &log->imu, [](const ImuSample& s) { return IsFinite(s); }, log);
  KeepForward(source, &log->imu, log);
}

/// Factor that takes the speeds of joint_states to rad/s.
double RotorSpeedScale(const std::string& file, const BagOptions& options) {
  const double rpm = M_PI / 30.0;
  if (options.rotor_speed_unit == "rad_s") return 1.0;
  if (options.rotor_speed_unit == "rpm") return rpm;
  if (options.rotor_speed_unit != "erpm") {
    Fail(file,
         "rotor_speed_unit must be rad_s, rpm or erpm, not '" + options.rotor_speed_unit + "'");
  }
  if (options.pole_pairs < 1) Fail(file, "pole_pairs must be at least 1");
  return rpm / options.pole_pairs;
}

void CheckSize(const std::string& source, size_t size, const char* what, int num_rotors) {
  if (static_cast<int>(size) == num_rotors) return;
  Fail(source, "has " + std::to_string(size) + " " + what + ", the vehicle has " +
                   std::to_string(num_rotors) + " rotors");
}

void ReadCommands(BagSource* bag, int num_rotors, FlightLog* log) {
  const std::string topic = bag->TopicOf("motor_commands");
  if (topic.empty()) return;
  const std::string source = bag->file() + ": " + topic;
  bag->Read<odmc::MotorCommands>(topic, [&](const odmc::MotorCommands& m) {
    CheckSize(source, m.throttle.size(), "commands", num_rotors);
    log->commands.push_back({FromRos(m.header.stamp),
                             Eigen::Map<const Eigen::VectorXd>(m.throttle.data(), num_rotors)});
  });
  KeepFinite(
      source, &log->commands, [](const CommandSample& s) { return s.throttle.allFinite(); }, log);
  KeepForward(source, &log->commands, log);
}

RotorSample MakeRotorSample(const std::string& source, const ros::Time& stamp,
                            const std::vector<double>& speeds, double scale, int num_rotors) {
  CheckSize(source, speeds.size(), "speeds", num_rotors);
  RotorSample sample;
  sample.stamp = FromRos(stamp);
  sample.speed = scale * Eigen::Map<const Eigen::VectorXd>(speeds.data(), num_rotors);
  return sample;
}

void ReadRotors(BagSource* bag, int num_rotors, const BagOptions& options, FlightLog* log) {
  const double scale = RotorSpeedScale(bag->file(), options);
  // A mapped joint_states says which of the two the user means.
  std::string topic = options.topics.count("joint_states") > 0 ? "" : bag->TopicOf("rotor_speeds");
  const std::string joint_topic = topic.empty() ? bag->TopicOf("joint_states") : "";
  const std::string source = bag->file() + ": " + topic + joint_topic;
  if (!topic.empty()) {
    bag->Read<odmc::RotorSpeeds>(topic, [&](const odmc::RotorSpeeds& m) {
      log->rotors.push_back(
          MakeRotorSample(source, m.header.stamp, m.angular_velocity_rad_s, 1.0, num_rotors));
      log->rotor_rms_only = log->rotor_rms_only || m.rms_only;
    });
  } else if (!joint_topic.empty()) {
    bag->Read<sensor_msgs::JointState>(joint_topic, [&](const sensor_msgs::JointState& m) {
      log->rotors.push_back(
          MakeRotorSample(source, m.header.stamp, SpeedsOfJoints(m), scale, num_rotors));
    });
  } else if (!log->commands.empty()) {
    return;  // no sensor: commands may stand in
  } else {
    Fail(bag->file(),
         "no rotor speeds (odmc/RotorSpeeds or sensor_msgs/JointState); " + bag->Contents());
  }
  KeepFinite(
      source, &log->rotors, [](const RotorSample& s) { return s.speed.allFinite(); }, log);
  KeepForward(source, &log->rotors, log);
  if (log->rotors.empty()) Fail(source, "no usable rotor speeds");
  TakeSpeedMagnitudes(source, log);
  WarnOfDeadRotors(source, log);
}

void ReadBattery(BagSource* bag, FlightLog* log) {
  const std::string topic = bag->TopicOf("battery_state");
  if (topic.empty()) return;
  bag->Read<sensor_msgs::BatteryState>(topic, [&](const sensor_msgs::BatteryState& m) {
    log->battery.push_back({FromRos(m.header.stamp), FromFloat(m.voltage)});
  });
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
      Fail(bag->file(), std::string("is damaged: ") + kShiftTopic + " holds no shift of stamps");
    }
    return m->data;
  }
  return 0;
}

FlightLog ReadOpenBag(BagSource* bag, int num_rotors, PoseSource pose, const BagOptions& options) {
  FlightLog log;
  log.file = std::filesystem::path(bag->file()).filename().string();
  const bool poses_mapped =
      options.topics.count("pose") > 0 && options.topics.count("odometry") == 0;
  const std::string odometry_topic = poses_mapped ? "" : bag->TopicOf("odometry");
  const bool needs_poses = odometry_topic.empty() || pose == PoseSource::kMocap;
  const std::string pose_topic = needs_poses ? bag->TopicOf("pose") : "";
  if (needs_poses && pose_topic.empty()) {
    Fail(bag->file(),
         "no odometry (nav_msgs/Odometry or geometry_msgs/PoseStamped); " + bag->Contents());
  }
  ReadImu(bag, &log);
  if (!odometry_topic.empty()) log.odometry = ReadOdometry(bag, odometry_topic, options, &log);
  if (needs_poses) UseMocapPoses(ReadPoses(bag, pose_topic, &log), &log);
  ReadCommands(bag, num_rotors, &log);
  ReadRotors(bag, num_rotors, options, &log);
  ReadBattery(bag, &log);
  ShiftAll(-ReadShift(bag), &log);
  return log;
}

FlightLog ReadOpenActuatorBag(BagSource* bag, const BagOptions& options) {
  FlightLog log;
  log.file = std::filesystem::path(bag->file()).filename().string();
  const std::string topic = bag->TopicOf("motor_commands");
  if (topic.empty()) Fail(bag->file(), "no odmc/MotorCommands; " + bag->Contents());
  std::optional<size_t> commands;  // of the first message
  bag->Read<odmc::MotorCommands>(topic, [&](const odmc::MotorCommands& m) {
    if (!commands) commands = m.throttle.size();
  });
  if (!commands) Fail(bag->file(), topic + " has no message");
  if (*commands < 1 || *commands > kMaxRotors)
    Fail(bag->file(), topic + " has " + std::to_string(*commands) + " commands");
  const auto num_rotors = static_cast<int>(*commands);
  ReadCommands(bag, num_rotors, &log);
  ReadRotors(bag, num_rotors, options, &log);
  if (log.rotors.empty()) Fail(bag->file(), "no rotor speeds; " + bag->Contents());
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

template <typename Read>
FlightLog ReadOpened(const std::string& file, const BagOptions& options, const Read& read) {
  try {
    Restrict(LimitsFor(std::filesystem::file_size(file)));
    Restrict(LimitsFor(CheckBagStructure(file).uncompressed_bytes));
    BagSource bag(file, options);
    return read(&bag);
  } catch (const std::invalid_argument&) {
    throw;
  } catch (const std::bad_alloc&) {
    Fail(file, "is damaged: a length in it asks for more memory than the whole bag needs");
  } catch (const std::exception& e) {
    // A damaged chunk or record shows as any of a dozen exceptions of rosbag and its libraries.
    Fail(file, std::string("is damaged or truncated: ") + e.what());
  }
}

/// The bag library takes lengths and counts as it finds them: a child process reads.
template <typename Read>
FlightLog WithOpenBag(const std::string& file, const BagOptions& options, const Read& read) {
  if (!std::filesystem::is_regular_file(file)) Fail(file, "cannot be opened");
  FlightLog log = ReadInChild(file, [&] { return ReadOpened(file, options, read); });
  log.file = Printable(log.file);
  for (std::string& warning : log.warnings) warning = Printable(warning);  // names of topics
  return log;
}

FlightLog ReadBag(const std::string& file, int num_rotors, PoseSource pose,
                  const BagOptions& options) {
  if (options.twist_frame != "auto" && options.twist_frame != "body" &&
      options.twist_frame != "world") {
    Fail(file, "twist_frame must be auto, body or world, not '" + options.twist_frame + "'");
  }
  return WithOpenBag(file, options,
                     [&](BagSource* bag) { return ReadOpenBag(bag, num_rotors, pose, options); });
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
  return ReadBag(file, num_rotors, PoseSource::kEkf, options);
}

FlightLog ReadActuatorBag(const std::string& file, const BagOptions& options) {
  return WithOpenBag(file, options,
                     [&](BagSource* bag) { return ReadOpenActuatorBag(bag, options); });
}

FlightReaders AllFlightReaders(const BagOptions& options) {
  FlightReaders readers = FlightReaders::Core();
  readers.Add({"a rosbag (.bag)", {".bag"},
               [](std::string_view head) { return head.substr(0, 9) == "#ROSBAG V"; }, false,
               [options](const std::string& file, const FlightReadOptions& read) {
                 return ReadBag(file, read.num_rotors, read.pose, options);
               }});
  return readers;
}

FlightLog ReadFlight(const std::string& file, int num_rotors, PoseSource pose,
                     const BagOptions& options) {
  return AllFlightReaders(options).Read(file, {num_rotors, pose, std::nullopt});
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
