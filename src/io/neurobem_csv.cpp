#include <cmath>
#include <stdexcept>

#include "csv_table.h"
#include "csv_text.h"
#include "frame_checks.h"
#include "odmc/io/data_sets.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

using Strings = std::vector<std::string>;

const Strings kPosition = {"pos x", "pos y", "pos z"};
const Strings kQuaternion = {"quat w", "quat x", "quat y", "quat z"};
const Strings kVelocity = {"vel x", "vel y", "vel z"};
const Strings kRates = {"ang vel x", "ang vel y", "ang vel z"};
const Strings kMotors = {"mot 1", "mot 2", "mot 3", "mot 4"};
const Strings kAcceleration = {"acc x", "acc y", "acc z"};
constexpr double kUnitTolerance = 0.05;  // as NormaliseAttitudes()

/// The usable rows in the source's terms.
struct Rows {
  std::vector<Stamp> stamps;
  std::vector<double> t_s;  // since the first
  std::vector<Eigen::Vector4d> named_q;
  TimedVectors position, rates, velocity, acceleration;  // velocity in the frame of the file
  std::vector<RotorVector> motors;
  std::vector<double> voltage_V;  // empty without a column

  TimedTurns Turns(const QuaternionReading& reading) const {
    TimedTurns turns{t_s, {}};
    for (const Eigen::Vector4d& named : named_q) turns.q.push_back(reading.Of(named).normalized());
    return turns;
  }
};

Eigen::Matrix3Xd Pick(const CsvTable& table, const Strings& names,
                      const std::vector<size_t>& rows) {
  Eigen::Matrix3Xd values(3, static_cast<Eigen::Index>(rows.size()));
  const auto group = table.Columns<3>(names);
  for (size_t i = 0; i < rows.size(); ++i) {
    for (int k = 0; k < 3; ++k) values(k, static_cast<Eigen::Index>(i)) = group(k, rows[i]);
  }
  return values;
}

/// Rows where all that is needed is finite and the quaternion is unit.
std::vector<size_t> SoundRows(const CsvTable& table, bool has_velocity, FlightLog* log) {
  const auto p = table.Columns<3>(kPosition), w = table.Columns<3>(kRates);
  const auto q = table.Columns<4>(kQuaternion), motors = table.Columns<4>(kMotors);
  const auto v = table.Columns<3>(has_velocity ? kVelocity : kPosition);
  std::vector<size_t> rows;
  RefusedSamples not_finite, not_unit;
  for (size_t i = 0; i < table.size(); ++i) {
    if (!p.IsFinite(i) || !q.IsFinite(i) || !w.IsFinite(i) || !motors.IsFinite(i) ||
        !v.IsFinite(i)) {
      not_finite.Add(table.Where(i));
      continue;
    }
    const double norm = Eigen::Vector4d(q(0, i), q(1, i), q(2, i), q(3, i)).norm();
    if (std::abs(norm - 1.0) > kUnitTolerance) {
      not_unit.Add(table.Where(i));
    } else {
      rows.push_back(i);
    }
  }
  if (static_cast<size_t>(not_unit.count) > rows.size()) {
    RefuseFile(table.file(), "the quaternions are not unit: " + std::to_string(not_unit.count) +
                                 " are off by more than 5 % (first: " + not_unit.first + ")");
  }
  not_finite.Report(table.name(), "rows that are not finite", log);
  not_unit.Report(table.name(), "rows whose quaternion is not unit", log);
  if (rows.empty()) RefuseFile(table.file(), "no usable row");
  return rows;
}

Rows ReadRows(const CsvTable& table, FlightLog* log) {
  table.Require({"t"});
  for (const Strings& group : {kPosition, kQuaternion, kRates, kMotors}) table.Require(group);
  for (const Strings& group : {kVelocity, kAcceleration}) table.CheckAllOrNone(group);
  const bool has_velocity = table.HasAll(kVelocity);
  const std::vector<size_t> sound = SoundRows(table, has_velocity, log);
  Rows rows;
  const auto q = table.Columns<4>(kQuaternion), motors = table.Columns<4>(kMotors);
  for (const size_t i : sound) {
    rows.stamps.push_back(table.stamp(i));
    rows.t_s.push_back(ToSeconds(table.stamp(i) - table.stamp(sound.front())));
    rows.named_q.emplace_back(q(0, i), q(1, i), q(2, i), q(3, i));
    RotorVector speeds(4);
    for (int j = 0; j < 4; ++j) speeds[j] = motors(j, i);
    rows.motors.push_back(speeds);
    if (table.HasAll({"vbat"})) rows.voltage_V.push_back(table.Column("vbat")[i]);
  }
  rows.position = {rows.t_s, Pick(table, kPosition, sound)};
  rows.rates = {rows.t_s, Pick(table, kRates, sound)};
  if (has_velocity) rows.velocity = {rows.t_s, Pick(table, kVelocity, sound)};
  if (table.HasAll(kAcceleration))
    rows.acceleration = {rows.t_s, Pick(table, kAcceleration, sound)};
  return rows;
}

/// Vectors of the body in the world.
TimedVectors Turned(const TimedTurns& turns, const TimedVectors& in_body) {
  TimedVectors turned = in_body;
  for (size_t i = 0; i < turns.q.size(); ++i) {
    const auto k = static_cast<Eigen::Index>(i);
    turned.values.col(k) = turns.q[i] * Eigen::Vector3d(in_body.values.col(k));
  }
  return turned;
}

/// What the data say about the open points of the format.
struct Findings {
  std::string quaternion;
  bool velocity_in_world = false;
};

std::string VelocityFrame(const Rows& rows, const TimedTurns& turns, const CheckSpans& spans) {
  const Eigen::Matrix3Xd moved = SlopesOver(rows.position, spans);
  ReadingResiduals residuals("m/s", moved);
  residuals.Add("body", MeansOver(Turned(turns, rows.velocity), spans) - moved);
  residuals.Add("world", MeansOver(rows.velocity, spans) - moved);
  return residuals.Fitting("body", 0.2, 0.05, "velocity frame").front();
}

Findings Check(const Rows& rows) {
  const CheckSpans spans = SpansOf(rows.t_s);
  const Eigen::Matrix3Xd mean = MeansOver(rows.rates, spans);
  ReadingResiduals residuals("rad/s", mean);
  for (const QuaternionReading& reading : QuaternionReadings()) {
    residuals.Add(reading.name, RatesOver(rows.Turns(reading), spans) - mean);
  }
  Findings findings;
  findings.quaternion = FirstAccepted(
      residuals.Fitting("as named", 0.3, 0.1, "quaternion order"), [&](const std::string& name) {
        const TimedTurns turns = rows.Turns(ReadingNamed(name));
        if (!rows.velocity.t_s.empty()) {
          findings.velocity_in_world = VelocityFrame(rows, turns, spans) == "world";
        }
        CheckThrustIsUp(rows.position, turns.q);
      });
  return findings;
}

/// Refuses acc where it is not the specific force along the body.
void CheckAccelerometer(const Rows& rows, const TimedTurns& turns, const TimedVectors& v_WB) {
  const CheckSpans spans = SpansOf(rows.t_s);
  const Eigen::Matrix3Xd expected =
      SlopesOver(v_WB, spans).colwise() + Eigen::Vector3d(0.0, 0.0, 9.81);
  ReadingResiduals residuals("m/s^2", expected);
  residuals.Add("specific force", MeansOver(Turned(turns, rows.acceleration), spans) - expected);
  residuals.Fitting("specific force", 0.1, 0.5, "acc");
}

void Tell(const Findings& findings, FlightLog* log) {
  if (findings.quaternion != "as named") {
    log->warnings.push_back(log->file + ": the quaternion is read " + findings.quaternion +
                            ", as the body rates demand");
  }
  if (findings.velocity_in_world) {
    log->warnings.push_back(log->file +
                            ": the velocity is in the world frame, as d(position)/dt demands");
  }
}

void AddSamples(const Rows& rows, const TimedTurns& turns, const TimedVectors& v_WB,
                bool accelerometer, FlightLog* log) {
  for (size_t i = 0; i < rows.stamps.size(); ++i) {
    const auto k = static_cast<Eigen::Index>(i);
    OdometrySample pose;
    pose.stamp = rows.stamps[i];
    pose.p_WS = rows.position.values.col(k);
    pose.q_WS = turns.q[i];
    if (!v_WB.t_s.empty()) pose.v_WS = v_WB.values.col(k);
    pose.w_WS_S = rows.rates.values.col(k);
    log->odometry.push_back(pose);
    log->rotors.push_back({pose.stamp, rows.motors[i]});
    if (accelerometer && rows.acceleration.values.col(k).allFinite()) {
      ImuSample imu;
      imu.stamp = pose.stamp;
      imu.specific_force_I = rows.acceleration.values.col(k);
      log->imu.push_back(imu);
    }
    if (!rows.voltage_V.empty() && std::isfinite(rows.voltage_V[i])) {
      log->battery.push_back({pose.stamp, rows.voltage_V[i]});
    }
  }
}

}  // namespace

bool IsNeurobem(std::string_view head) {
  head = WithoutMark(head);
  std::string_view line = head.substr(0, head.find('\n'));
  int found = 0;
  while (!line.empty()) {
    const std::string_view cell = Unquoted(NextCell(&line));
    for (const char* name : {"pos x", "quat w", "ang vel x", "vel x", "mot 1"}) {
      if (cell == name) ++found;
    }
  }
  return found >= 3;  // one that is lost is named by the reader
}

FlightLog ReadNeurobem(const std::string& file, const FlightReadOptions& options) {
  if (options.num_rotors != 4) {
    RefuseFile(file, "a NeuroBEM flight has 4 rotors, the vehicle has " +
                         std::to_string(options.num_rotors));
  }
  if (options.pose == PoseSource::kMocap) {
    RefuseFile(file, "--pose mocap is for CSV files and bags; a NeuroBEM flight has one pose");
  }
  FlightLog log;
  log.file = PrintableName(file);
  Strings wanted = {"t", "vbat"};
  for (const Strings& group : {kPosition, kQuaternion, kVelocity, kRates, kMotors, kAcceleration}) {
    wanted.insert(wanted.end(), group.begin(), group.end());
  }
  const Rows rows = ReadRows(CsvTable(file, wanted, {}, &log), &log);
  if (options.accelerometer && (rows.acceleration.t_s.empty() || rows.velocity.t_s.empty())) {
    RefuseFile(file, "--accelerometer needs the columns 'acc' and 'vel'");
  }
  try {
    const Findings findings = Check(rows);
    Tell(findings, &log);
    const TimedTurns turns = rows.Turns(ReadingNamed(findings.quaternion));
    const TimedVectors v_WB = findings.velocity_in_world || rows.velocity.t_s.empty()
                                  ? rows.velocity
                                  : Turned(turns, rows.velocity);
    if (options.accelerometer) {
      try {
        CheckAccelerometer(rows, turns, v_WB);
      } catch (const std::invalid_argument& e) {
        throw std::invalid_argument(std::string(e.what()) + "; leave out --accelerometer");
      }
    }
    AddSamples(rows, turns, v_WB, options.accelerometer, &log);
  } catch (const std::invalid_argument& e) {
    RefuseFile(file, e.what());
  }
  NormaliseAttitudes(file, &log.odometry, &log);
  TakeSpeedMagnitudes(log.file, &log);
  WarnOfDeadRotors(log.file, &log);
  return log;
}

}  // namespace odmc
