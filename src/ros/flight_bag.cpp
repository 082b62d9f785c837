#include "odmc/ros/flight_bag.h"

#include <rosbag/view.h>
#include <std_msgs/Int64.h>

#include <cmath>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <new>
#include <stdexcept>
#include <utility>
#include <vector>

#include "bag_motion.h"
#include "bag_source.h"
#include "bag_structure.h"
#include "blackbird_bag.h"
#include "child_reader.h"
#include "finite_samples.h"
#include "odmc/sensing/flight_checks.h"
#include "odmc/sensing/twist_frame.h"
#include "odmc/text/printable_text.h"
#include "odmc/text/refusal.h"
#include "stamp_shift.h"

namespace odmc {
namespace {

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
  if (!TwistFrameStated(options.twist_frame)) {
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

}  // namespace odmc
