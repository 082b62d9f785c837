#include <algorithm>
#include <cmath>
#include <filesystem>
#include <utility>

#include "binary_file.h"
#include "log_streams.h"
#include "odmc/io/autopilot_logs.h"
#include "odmc/math/statistics.h"
#include "odmc/math/units.h"
#include "odmc/text/format.h"
#include "odmc/text/printable_text.h"
#include "odmc/text/refusal.h"
#include "ulog_file.h"

namespace odmc {
namespace {

using Strings = std::vector<std::string>;

constexpr int kMotor1 = 101;   // actuator_function of esc_report
constexpr int kBodyFrame = 3;  // velocity_frame of vehicle_odometry: FRD of the body
const RateHints kHints = {
    "add the lines 'vehicle_odometry 20' (or 'vehicle_local_position 20' and 'vehicle_attitude 20')"
    " to etc/logging/logger_topics.txt on the SD card (docs/logs.md has all lines)",
    "PX4's default for esc_status is 4 Hz; add the line 'esc_status 5' to "
    "etc/logging/logger_topics.txt on the SD card (docs/logs.md has all lines)",
    "add the line 'sensor_combined 0' to etc/logging/logger_topics.txt on the SD card "
    "(docs/logs.md has all lines)"};

const Strings kPosition = Elements("position", 3), kQuaternion = Elements("q", 4),
              kVelocity = Elements("velocity", 3), kRates = Elements("angular_velocity", 3);
const Strings kOldPosition = {"x", "y", "z"}, kOldVelocity = {"vx", "vy", "vz"},
              kOldRates = {"rollspeed", "pitchspeed", "yawspeed"};

WantedFields Wanted(int num_rotors) {
  WantedFields wanted;
  const auto add = [&](const std::string& topic, std::initializer_list<Strings> lists) {
    for (const Strings& list : lists) {
      wanted[topic].insert(wanted[topic].end(), list.begin(), list.end());
    }
  };
  add("vehicle_odometry", {{"timestamp_sample", "velocity_frame"},
                           kPosition,
                           kQuaternion,
                           kVelocity,
                           kRates,
                           kOldPosition,
                           kOldVelocity,
                           kOldRates});
  add("vehicle_local_position", {{"timestamp_sample"}, kOldPosition, kOldVelocity});
  add("vehicle_attitude", {{"timestamp_sample"}, kQuaternion});
  add("sensor_combined", {Elements("gyro_rad", 3), Elements("accelerometer_m_s2", 3)});
  add("vehicle_angular_velocity", {{"timestamp_sample"}, Elements("xyz", 3)});
  add("vehicle_acceleration", {{"timestamp_sample"}, Elements("xyz", 3)});
  add("battery_status", {{"voltage_v"}});
  add("actuator_motors", {{"timestamp_sample"}, Elements("control", num_rotors)});
  add("actuator_outputs", {Elements("output", num_rotors)});
  wanted["esc_status"] = {"esc_count"};
  for (const std::string& esc : Elements("esc", kMaxRotors)) {
    for (const char* field : {".timestamp", ".esc_rpm", ".actuator_function"}) {
      wanted["esc_status"].push_back(esc + field);
    }
  }
  return wanted;
}

/// When the sample was taken; the message's own stamp where it does not say.
Stamp SampleStamp(const MessageColumns& table, size_t row) {
  if (!table.Has("timestamp_sample")) return table.stamps[row];
  const double sample_us = table.At("timestamp_sample", row);
  const bool is_near =
      sample_us > 0.0 && std::abs(1e3 * sample_us - static_cast<double>(table.stamps[row])) < 1e9;
  return is_near ? 1000 * static_cast<Stamp>(sample_us) : table.stamps[row];
}

Eigen::Quaterniond Quaternion(const FieldGroup& q, size_t row) {
  return {q(0, row), q(1, row), q(2, row), q(3, row)};
}

FieldGroup EitherOf(const MessageColumns& table, const Strings& fields, const Strings& old_fields) {
  const FieldGroup now(table, fields);
  return now.present() ? now : FieldGroup(table, old_fields);
}

/// Poses of vehicle_odometry: FRD in NED, or in a frame of some other heading.
std::vector<OdometrySample> FromOdometry(const MessageColumns& table) {
  const FieldGroup p = EitherOf(table, kPosition, kOldPosition), q(table, kQuaternion),
                   v = EitherOf(table, kVelocity, kOldVelocity),
                   w = EitherOf(table, kRates, kOldRates);
  std::vector<OdometrySample> samples;
  if (!p.present() || !q.present()) return samples;
  for (size_t i = 0; i < table.size(); ++i) {
    OdometrySample sample;
    sample.stamp = SampleStamp(table, i);
    sample.p_WS = EnuFromNed(p.Vector(i));
    sample.q_WS = EnuFromNed(Quaternion(q, i));
    if (v.present() && v.Vector(i).allFinite()) {
      const bool is_body =
          table.Has("velocity_frame") && table.At("velocity_frame", i) == kBodyFrame;
      sample.v_WS =
          is_body ? sample.q_WS.normalized() * FluFromFrd(v.Vector(i)) : EnuFromNed(v.Vector(i));
    }
    if (w.present() && w.Vector(i).allFinite()) sample.w_WS_S = FluFromFrd(w.Vector(i));
    if (sample.p_WS.allFinite() && sample.q_WS.coeffs().allFinite()) samples.push_back(sample);
  }
  return samples;
}

/// Poses of vehicle_local_position, with the attitude turned to their stamps.
std::vector<OdometrySample> FromPositionAndAttitude(const MessageColumns& positions,
                                                    const MessageColumns& attitudes,
                                                    FlightLog* log) {
  const FieldGroup p(positions, kOldPosition), v(positions, kOldVelocity),
      q(attitudes, kQuaternion);
  std::vector<OdometrySample> samples;
  std::vector<AttitudeReading> turns;
  if (!p.present() || !q.present()) return samples;
  for (size_t i = 0; i < attitudes.size(); ++i) {
    turns.push_back({SampleStamp(attitudes, i), EnuFromNed(Quaternion(q, i))});
  }
  for (size_t i = 0; i < positions.size(); ++i) {
    OdometrySample sample;
    sample.stamp = SampleStamp(positions, i);
    sample.p_WS = EnuFromNed(p.Vector(i));
    if (v.present() && v.Vector(i).allFinite()) sample.v_WS = EnuFromNed(v.Vector(i));
    samples.push_back(sample);
  }
  JoinAttitudes(turns, &samples, log);
  return samples;
}

constexpr double kAsFast = 0.8;  // of another stream's rate: the first one is preferred

void ReadPoses(const std::string& file, const ULogContent& log_file, FlightPart part,
               FlightLog* log) {
  const MessageColumns* odometry = log_file.Find("vehicle_odometry");
  const MessageColumns* positions = log_file.Find("vehicle_local_position");
  const MessageColumns* attitudes = log_file.Find("vehicle_attitude");
  std::vector<OdometrySample> joined;
  if (odometry != nullptr) log->odometry = FromOdometry(*odometry);
  if (positions != nullptr && attitudes != nullptr) {
    joined = FromPositionAndAttitude(*positions, *attitudes, log);
  }
  if (log->odometry.empty() || RateOf(log->odometry) < kAsFast * RateOf(joined)) {
    if (!joined.empty()) log->odometry = std::move(joined);
  }
  if (log->odometry.empty() && part != FlightPart::kOnboard) {
    RefuseFile(
        file,
        "no pose: neither vehicle_odometry nor vehicle_local_position with "
        "vehicle_attitude; " +
            kHints.pose +
            ". Without an estimator, --odometry FILE takes poses from a recording beside the log");
  }
}

void ReadVectors(const MessageColumns& table, const Strings& fields,
                 std::optional<Eigen::Vector3d> ImuSample::*value, FlightLog* log) {
  const FieldGroup group(table, fields);
  for (size_t i = 0; group.present() && i < table.size(); ++i) {
    ImuSample sample;
    sample.stamp = SampleStamp(table, i);
    sample.*value = FluFromFrd(group.Vector(i));
    log->imu.push_back(sample);
  }
}

/// The filtered gyro and accelerometer, which have messages of their own.
void ReadFilteredImu(const ULogContent& log_file, FlightLog* log) {
  if (const MessageColumns* w = log_file.Find("vehicle_angular_velocity")) {
    ReadVectors(*w, Elements("xyz", 3), &ImuSample::gyro_I, log);
  }
  if (const MessageColumns* a = log_file.Find("vehicle_acceleration")) {
    ReadVectors(*a, Elements("xyz", 3), &ImuSample::specific_force_I, log);
  }
  std::sort(log->imu.begin(), log->imu.end(),
            [](const ImuSample& a, const ImuSample& b) { return a.stamp < b.stamp; });
  // Both of one moment are one sample.
  std::vector<ImuSample> merged;
  for (const ImuSample& sample : log->imu) {
    if (merged.empty() || merged.back().stamp != sample.stamp) {
      merged.push_back(sample);
    } else if (sample.gyro_I) {
      merged.back().gyro_I = sample.gyro_I;
    } else {
      merged.back().specific_force_I = sample.specific_force_I;
    }
  }
  log->imu = std::move(merged);
}

void ReadImu(const ULogContent& log_file, FlightLog* log) {
  const MessageColumns* raw = log_file.Find("sensor_combined");
  const MessageColumns* filtered = log_file.Find("vehicle_angular_velocity");
  const double raw_rate = raw == nullptr ? 0.0 : UsualRate(raw->stamps);
  const double filtered_rate = filtered == nullptr ? 0.0 : UsualRate(filtered->stamps);
  if (raw == nullptr || raw_rate < kAsFast * std::min(filtered_rate, 200.0)) {
    return ReadFilteredImu(log_file, log);
  }
  const FieldGroup gyro(*raw, Elements("gyro_rad", 3)),
      acc(*raw, Elements("accelerometer_m_s2", 3));
  if (!gyro.present() || !acc.present()) return;
  for (size_t i = 0; i < raw->size(); ++i) {
    AddImuReading(raw->stamps[i], gyro.Vector(i), acc.Vector(i), log);
  }
}

/// The usual value of a column, one that occurs: it may be a code. 0 for an empty one.
double UsualValue(std::vector<double> values) {
  values.erase(std::remove_if(values.begin(), values.end(), [](double v) { return std::isnan(v); }),
               values.end());
  return values.empty() ? 0.0 : MiddleOf(std::move(values));
}

/// Which entries of esc_status are the motors 1, 2, ...: by their function where the log says it,
/// else as they come.
std::vector<int> MotorOrder(const MessageColumns& table, int num_rotors) {
  std::vector<int> order(static_cast<size_t>(num_rotors), -1), plain;
  int found = 0;
  for (int i = 0; i < kMaxRotors; ++i) {
    const std::string field = "esc[" + std::to_string(i) + "].actuator_function";
    if (i < num_rotors) plain.push_back(i);
    if (!table.Has(field)) continue;
    const int motor = static_cast<int>(UsualValue(table.values.at(field))) - kMotor1;
    if (motor < 0 || motor >= num_rotors || order[static_cast<size_t>(motor)] >= 0) continue;
    order[static_cast<size_t>(motor)] = i;
    ++found;
  }
  return found == num_rotors ? order : plain;
}

/// Readings of one entry of esc_status, at the ESC's own stamps.
RotorReadings ReadingsOf(const MessageColumns& table, int esc, double scale) {
  const std::string name = "esc[" + std::to_string(esc) + "]";
  const std::string own_stamp = name + ".timestamp", speed = name + ".esc_rpm";
  RotorReadings readings;
  for (size_t i = 0; i < table.size(); ++i) {
    Stamp stamp = table.stamps[i];
    if (table.Has(own_stamp) && table.At(own_stamp, i) > 0.0 &&
        std::abs(1e3 * table.At(own_stamp, i) - static_cast<double>(stamp)) < 1e9) {
      stamp = 1000 * static_cast<Stamp>(table.At(own_stamp, i));
    }
    readings.Add(stamp, scale * table.At(speed, i));
  }
  return readings;
}

void ReadRotors(const std::string& file, const ULogContent& log_file,
                const FlightReadOptions& options, FlightLog* log) {
  const MessageColumns* table = log_file.Find("esc_status");
  if (table == nullptr) return;
  const double count = table->Has("esc_count") ? UsualValue(table->values.at("esc_count")) : 0.0;
  if (count > 0.0 && static_cast<int>(count) != options.num_rotors) {
    RefuseFile(file, "esc_status has " + std::to_string(static_cast<int>(count)) +
                         " ESCs, the vehicle has " + std::to_string(options.num_rotors) +
                         " rotors");
  }
  const double scale =
      kRpm * PoleScale(file, log_file.parameters, "MOT_POLE_COUNT", options.pole_pairs);
  std::vector<RotorReadings> rotors;
  for (const int esc : MotorOrder(*table, options.num_rotors)) {
    if (!table->Has("esc[" + std::to_string(esc) + "].esc_rpm")) {
      RefuseFile(file, "esc_status has no entry " + std::to_string(esc) + " with esc_rpm");
    }
    rotors.push_back(ReadingsOf(*table, esc, scale));
  }
  const double rate = UsualRate(rotors.front().stamps);
  log->rotors = OnOneClock(rotors);
  if (log->rotors.empty() && rate > 0.0) {
    RefuseFile(file, "esc_status: the ESCs never answer within four readings of each other");
  }
}

void AddCommands(const MessageColumns& table, const FieldGroup& fields, int num_rotors,
                 CommandUnit unit, FlightLog* log) {
  log->command_unit = unit;
  for (size_t i = 0; i < table.size(); ++i) {
    CommandSample sample{SampleStamp(table, i), RotorVector(num_rotors)};
    for (int j = 0; j < num_rotors; ++j) {
      const double command = fields(static_cast<size_t>(j), i);
      // A motor that is off has none.
      sample.throttle[j] = std::isfinite(command) ? ThrottleOf(command, unit) : 0.0;
    }
    log->commands.push_back(sample);
  }
}

void ReadCommands(const ULogContent& log_file, int num_rotors, FlightLog* log) {
  if (const MessageColumns* motors = log_file.Find("actuator_motors")) {
    const FieldGroup control(*motors, Elements("control", num_rotors));
    if (control.present()) {
      return AddCommands(*motors, control, num_rotors, CommandUnit::kFraction, log);
    }
  }
  for (int instance = 0; instance < 4; ++instance) {
    const MessageColumns* outputs = log_file.Find("actuator_outputs", instance);
    if (outputs == nullptr) continue;
    const FieldGroup fields(*outputs, Elements("output", num_rotors));
    if (!fields.present()) continue;
    const double usual = UsualValue(outputs->values.at("output[0]"));
    if (usual < 800.0 || usual > 2200.0) continue;  // no pulse lengths
    return AddCommands(*outputs, fields, num_rotors, CommandUnit::kMicroseconds, log);
  }
}

void ReadBattery(const ULogContent& log_file, FlightLog* log) {
  const MessageColumns* table = log_file.Find("battery_status");
  if (table == nullptr || !table->Has("voltage_v")) return;
  for (size_t i = 0; i < table->size(); ++i) {
    const double voltage = table->At("voltage_v", i);
    if (voltage > 0.0) log->battery.push_back({table->stamps[i], voltage});
  }
}

void Report(const std::string& file, const ULogContent& log_file, size_t bytes, FlightLog* log) {
  ReportDamage(file, log_file.damage, bytes, log);
  if (log_file.topic_names.empty()) RefuseFile(file, "ULog: holds no topic: cut off or damaged");
  if (log_file.lost_s > 0.0) {
    log->warnings.push_back(log->file +
                            Format(": the logger lost %.2f s (a slow SD card)", log_file.lost_s));
  }
}

}  // namespace

FlightLog ReadULog(const std::string& file, const FlightReadOptions& options) {
  if (options.pose == PoseSource::kMocap) {
    RefuseFile(file, "--pose mocap is for CSV files and bags; a PX4 log has the estimator's pose");
  }
  const std::string bytes = ReadBinary(file);
  FlightLog log;
  log.file = Printable(std::filesystem::path(file).filename().string());
  const ULogContent content = DecodeULog(file, bytes, Wanted(options.num_rotors));
  Report(file, content, bytes.size(), &log);
  ReadPoses(file, content, options.part, &log);
  if (options.part != FlightPart::kPoses) {
    ReadImu(content, &log);
    ReadCommands(content, options.num_rotors, &log);
    ReadRotors(file, content, options, &log);
    ReadBattery(content, &log);
    if (log.rotors.empty() && log.commands.empty()) {
      RefuseFile(file,
                 "no rotor speeds: there is no esc_status. ESCs that tell their speed are needed "
                 "(bidirectional DShot, DShot telemetry or UAVCAN); then " +
                     kHints.rotors);
    }
  }
  FinishLog(file, kHints, options.part, &log);
  return log;
}

}  // namespace odmc
