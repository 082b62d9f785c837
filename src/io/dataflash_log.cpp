#include <algorithm>
#include <cmath>
#include <filesystem>
#include <set>

#include "binary_file.h"
#include "dataflash_file.h"
#include "log_streams.h"
#include "odmc/io/autopilot_logs.h"
#include "odmc/math/units.h"
#include "odmc/text/printable_text.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

constexpr double kEarthRadius_m = 6378137.0;
const RateHints kHints = {
    "set bit 0 of LOG_BITMASK (fast attitude: LOG_BITMASK + 1), which logs ATT, XKF1 and XKQ at "
    "the "
    "control loop's rate",
    "bidirectional DShot (SERVO_BLH_BDMASK) gives ESC messages at up to 100 Hz; serial telemetry "
    "has "
    "the rate SERVO_BLH_TRATE",
    "set bit 18 of LOG_BITMASK (fast IMU: LOG_BITMASK + 262144)"};

/// The first of several messages that the log has.
const MessageColumns* FirstOf(const DataflashContent& content,
                              std::initializer_list<const char*> names) {
  for (const char* name : names) {
    if (const MessageColumns* table = content.First(name)) return table;
  }
  return nullptr;
}

// ---- Poses -------------------------------------------------------------------------------------

/// Positions and velocities of the filter, from its origin; the attitude is still missing.
std::vector<OdometrySample> FilterPositions(const MessageColumns& table) {
  const FieldGroup p(table, {"PN", "PE", "PD"}), v(table, {"VN", "VE", "VD"});
  std::vector<OdometrySample> samples;
  for (size_t i = 0; p.present() && i < table.size(); ++i) {
    OdometrySample sample;
    sample.stamp = table.stamps[i];
    sample.p_WS = EnuFromNed(p.Vector(i));
    if (v.present() && v.Vector(i).allFinite()) sample.v_WS = EnuFromNed(v.Vector(i));
    samples.push_back(sample);
  }
  return samples;
}

/// Positions by latitude and longitude, from the first one.
std::vector<OdometrySample> GlobalPositions(const MessageColumns& table) {
  const FieldGroup p(table, {"Lat", "Lng", "Alt"});
  std::vector<OdometrySample> samples;
  for (size_t i = 0; p.present() && i < table.size(); ++i) {
    OdometrySample sample;
    sample.stamp = table.stamps[i];
    const double east = kDegree * (p(1, i) - p(1, 0)) * std::cos(kDegree * p(0, 0));
    const double north = kDegree * (p(0, i) - p(0, 0));
    sample.p_WS << kEarthRadius_m * east, kEarthRadius_m * north, p(2, i) - p(2, 0);
    samples.push_back(sample);
  }
  return samples;
}

/// Attitude of FRD in NED from roll, pitch, yaw [deg].
Eigen::Quaterniond FromAngles(const Eigen::Vector3d& angles) {
  return Eigen::AngleAxisd(kDegree * angles.z(), Eigen::Vector3d::UnitZ()) *
         Eigen::AngleAxisd(kDegree * angles.y(), Eigen::Vector3d::UnitY()) *
         Eigen::AngleAxisd(kDegree * angles.x(), Eigen::Vector3d::UnitX());
}

std::vector<AttitudeReading> ReadAttitudes(const DataflashContent& content) {
  std::vector<AttitudeReading> attitudes;
  const MessageColumns* quaternions = FirstOf(content, {"XKQ", "NKQ"});
  const MessageColumns* angles = content.First("ATT");
  if (quaternions == nullptr && angles == nullptr) quaternions = content.First("AHR2");
  if (quaternions != nullptr) {
    const FieldGroup q(*quaternions, {"Q1", "Q2", "Q3", "Q4"});
    for (size_t i = 0; q.present() && i < quaternions->size(); ++i) {
      attitudes.push_back({quaternions->stamps[i],
                           EnuFromNed(Eigen::Quaterniond(q(0, i), q(1, i), q(2, i), q(3, i)))});
    }
  }
  if (!attitudes.empty() || angles == nullptr) return attitudes;
  const FieldGroup rpy(*angles, {"Roll", "Pitch", "Yaw"});
  for (size_t i = 0; rpy.present() && i < angles->size(); ++i) {
    attitudes.push_back({angles->stamps[i], EnuFromNed(FromAngles(rpy.Vector(i)))});
  }
  return attitudes;
}

void ReadPoses(const std::string& file, const DataflashContent& content, FlightPart part,
               FlightLog* log) {
  const MessageColumns* filter = FirstOf(content, {"XKF1", "NKF1"});
  const MessageColumns* global = content.First("POS");
  if (filter != nullptr) log->odometry = FilterPositions(*filter);
  if (log->odometry.empty() && global != nullptr) log->odometry = GlobalPositions(*global);
  if (log->odometry.empty()) {
    if (part == FlightPart::kOnboard) return;
    RefuseFile(file, "no position: neither XKF1 (or NKF1) nor POS; " + kHints.pose);
  }
  const std::vector<AttitudeReading> attitudes = ReadAttitudes(content);
  if (attitudes.empty() && part != FlightPart::kOnboard) {
    RefuseFile(file, "no attitude: none of XKQ, NKQ, ATT, AHR2; " + kHints.pose);
  }
  JoinAttitudes(attitudes, &log->odometry, log);
  if (log->odometry.empty() && part != FlightPart::kOnboard)
    RefuseFile(file, "positions and attitudes are nowhere at the same time");
}

// ---- The other streams -------------------------------------------------------------------------

void ReadImu(const DataflashContent& content, FlightLog* log) {
  const MessageColumns* table = content.First("IMU");
  if (table == nullptr) return;
  const FieldGroup gyro(*table, {"GyrX", "GyrY", "GyrZ"}), acc(*table, {"AccX", "AccY", "AccZ"});
  for (size_t i = 0; gyro.present() && acc.present() && i < table->size(); ++i) {
    AddImuReading(table->stamps[i], gyro.Vector(i), acc.Vector(i), log);
  }
}

RotorReadings ReadingsOf(const MessageColumns& table, double scale) {
  RotorReadings readings;
  const std::vector<double>& rpm = table.values.at("RPM");
  for (size_t i = 0; i < table.size(); ++i) readings.Add(table.stamps[i], scale * rpm[i]);
  return readings;
}

void ReadRotors(const std::string& file, const DataflashContent& content,
                const FlightReadOptions& options, FlightLog* log) {
  const double scale =
      kRpm * PoleScale(file, content.parameters, "SERVO_BLH_POLES", options.pole_pairs);
  std::vector<const MessageColumns*> escs;
  size_t most = 0;
  for (const auto& [key, table] : content.messages) {
    if (key.first != "ESC" || !table.Has("RPM")) continue;
    escs.push_back(&table);
    most = std::max(most, table.size());
  }
  std::vector<RotorReadings> rotors;
  for (const MessageColumns* esc : escs) {  // a damaged number of an ESC is no further one
    if (10 * esc->size() > most) rotors.push_back(ReadingsOf(*esc, scale));
  }
  if (rotors.empty()) return;
  if (static_cast<int>(rotors.size()) != options.num_rotors) {
    RefuseFile(file, "has ESC messages of " + std::to_string(rotors.size()) +
                         " ESCs, the vehicle has " + std::to_string(options.num_rotors) +
                         " rotors");
  }
  log->rotors = OnOneClock(rotors);
  if (log->rotors.empty())
    RefuseFile(file, "ESC: the ESCs never answer within four readings of each other");
}

void ReadCommands(const DataflashContent& content, int num_rotors, FlightLog* log) {
  const MessageColumns* table = content.First("RCOU");
  if (table == nullptr) return;
  std::vector<std::string> names;
  for (int j = 1; j <= num_rotors; ++j) names.push_back("C" + std::to_string(j));
  const FieldGroup outputs(*table, names);
  if (!outputs.present()) return;
  log->command_unit = CommandUnit::kMicroseconds;
  for (size_t i = 0; i < table->size(); ++i) {
    CommandSample sample{table->stamps[i], RotorVector(num_rotors)};
    for (int j = 0; j < num_rotors; ++j) {
      sample.throttle[j] =
          ThrottleOf(outputs(static_cast<size_t>(j), i), CommandUnit::kMicroseconds);
    }
    log->commands.push_back(sample);
  }
}

void ReadBattery(const DataflashContent& content, FlightLog* log) {
  const MessageColumns* table = content.First("BAT");
  if (table == nullptr || !table->Has("Volt")) return;
  for (size_t i = 0; i < table->size(); ++i) {
    if (table->At("Volt", i) > 0.0)
      log->battery.push_back({table->stamps[i], table->At("Volt", i)});
  }
}

}  // namespace

FlightLog ReadDataflash(const std::string& file, const FlightReadOptions& options) {
  if (options.pose == PoseSource::kMocap) {
    RefuseFile(file,
               "--pose mocap is for CSV files and bags; an ArduPilot log has the filter's pose");
  }
  const std::string bytes = ReadBinary(file);
  if (!IsDataflash(bytes)) {
    RefuseFile(file, "is no ArduPilot dataflash log: it does not start with FMT messages");
  }
  FlightLog log;
  log.file = Printable(std::filesystem::path(file).filename().string());
  const DataflashContent content = DecodeDataflash(
      bytes, {"XKF1", "NKF1", "POS", "XKQ", "NKQ", "ATT", "AHR2", "IMU", "ESC", "RCOU", "BAT"});
  ReportDamage(file, content.damage, bytes.size(), &log);
  ReadPoses(file, content, options.part, &log);
  if (options.part != FlightPart::kPoses) {
    ReadImu(content, &log);
    ReadCommands(content, options.num_rotors, &log);
    ReadRotors(file, content, options, &log);
    ReadBattery(content, &log);
    if (log.rotors.empty() && log.commands.empty()) {
      RefuseFile(
          file,
          "no rotor speeds: there are no ESC messages. ESCs that tell their speed are needed: " +
              kHints.rotors);
    }
  }
  FinishLog(file, kHints, options.part, &log);
  return log;
}

}  // namespace odmc
