#include <cmath>
#include <map>

#include "log_streams.h"
#include "log_writing.h"
#include "odmc/io/autopilot_log_writers.h"
#include "odmc/math/units.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

using Eigen::Vector3d;

constexpr float kPoles = 14.0F;
constexpr int kMostOutputs = 14;  // columns C1 .. of RCOU

enum Kind : std::uint8_t {
  kFormat = 128,
  kParameter = 64,
  kFilter,
  kQuaternion,
  kImu,
  kEsc,
  kOutputs,
  kBattery
};

struct MessageFormat {
  Kind kind;
  const char* name;
  const char* letters;  // Q 8, B 1, H 2, f 4, n 4, N 16, Z 64 bytes
  const char* columns;
};
constexpr MessageFormat kDefinitions[] = {
    {kFormat, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns"},
    {kParameter, "PARM", "QNff", "TimeUS,Name,Value,Default"},
    {kFilter, "XKF1", "QBffffff", "TimeUS,C,VN,VE,VD,PN,PE,PD"},
    {kQuaternion, "XKQ", "QBffff", "TimeUS,C,Q1,Q2,Q3,Q4"},
    {kImu, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"},
    {kEsc, "ESC", "QBf", "TimeUS,Instance,RPM"},
    {kOutputs, "RCOU", "QHHHHHHHHHHHHHH", "TimeUS,C1,C2,C3,C4,C5,C6,C7,C8,C9,C10,C11,C12,C13,C14"},
    {kBattery, "BAT", "QBf", "TimeUS,Inst,Volt"},
};

size_t LengthOf(std::string_view letters) {
  static const std::map<char, size_t> sizes = {{'Q', 8}, {'B', 1},  {'H', 2}, {'f', 4},
                                               {'n', 4}, {'N', 16}, {'Z', 64}};
  size_t length = 3;  // mark and kind
  for (const char letter : letters) length += sizes.at(letter);
  return length;
}

class Writer {
 public:
  explicit Writer(const FlightLog& log) : shift_(LogClockShift(log)) {}

  void WriteDefinitions() {
    for (const MessageFormat& d : kDefinitions) {
      out_.Text("\xa3\x95").Number(kFormat).Number(d.kind);
      out_.Number(static_cast<std::uint8_t>(LengthOf(d.letters)));
      out_.Padded(d.name, 4).Padded(d.letters, 16).Padded(d.columns, 64);
    }
    Start(kParameter, -shift_).Padded("SERVO_BLH_POLES", 16).Number(kPoles).Number(kPoles);
  }

  void Write(const OdometrySample& s) {
    const Vector3d p = EnuFromNed(s.p_WS), v = EnuFromNed(OrNan(s.v_WS));
    const Eigen::Quaterniond q = EnuFromNed(s.q_WS);  // turns that are their own inverse
    Start(kFilter, s.stamp).Number(std::uint8_t{0}).Floats(v).Floats(p);
    Start(kQuaternion, s.stamp)
        .Number(std::uint8_t{0})
        .Floats(Eigen::Vector4d(q.w(), q.x(), q.y(), q.z()));
  }
  void Write(const ImuSample& s) {
    Start(kImu, s.stamp)
        .Number(std::uint8_t{0})
        .Floats(FluFromFrd(OrNan(s.gyro_I)))
        .Floats(FluFromFrd(OrNan(s.specific_force_I)));
  }
  void Write(const RotorSample& s) {
    for (Eigen::Index j = 0; j < s.speed.size(); ++j) {
      Start(kEsc, s.stamp).Number(static_cast<std::uint8_t>(j)).Float(s.speed[j] / kRpm);
    }
  }
  void Write(const CommandSample& s) {
    ByteWriter& out = Start(kOutputs, s.stamp);
    for (int j = 0; j < kMostOutputs; ++j) {
      const double pulse_us =
          j < s.throttle.size() ? CommandOf(s.throttle[j], CommandUnit::kMicroseconds) : 0.0;
      out.Number(static_cast<std::uint16_t>(std::lround(pulse_us)));
    }
  }
  void Write(const BatterySample& s) {
    Start(kBattery, s.stamp).Number(std::uint8_t{0}).Float(s.voltage_V);
  }

  const std::string& bytes() const { return out_.bytes(); }

 private:
  ByteWriter& Start(Kind kind, Stamp stamp) {
    return out_.Text("\xa3\x95").Number(kind).Number(LogMicroseconds(stamp, shift_));
  }

  Stamp shift_;
  ByteWriter out_;
};

}  // namespace

void WriteDataflash(const FlightLog& log, const std::string& file) {
  if (RotorsOf(log, file) > kMostOutputs) {
    RefuseFile(file, "an ArduPilot log has at most " + std::to_string(kMostOutputs) + " outputs");
  }
  const std::vector<ImuSample> imu = ImuWithRates(log);
  Writer writer(log);
  writer.WriteDefinitions();
  StampOrder order;
  const auto write = [&writer](const auto& sample) { writer.Write(sample); };
  order.Add(log.odometry, write);
  order.Add(imu, write);
  order.Add(log.rotors, write);
  order.Add(log.commands, write);
  order.Add(log.battery, write);
  order.WriteAll();
  WriteBytes(writer.bytes(), file);
}

}  // namespace odmc
