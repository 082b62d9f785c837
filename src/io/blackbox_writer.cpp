#include <cmath>
#include <cstdint>

#include "log_streams.h"
#include "log_writing.h"
#include "odmc/io/autopilot_log_writers.h"
#include "odmc/math/units.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

using Eigen::VectorXd;

constexpr double kOneG = 2048.0;
constexpr double kFine = 10.0;  // of deg/s, with blackbox_high_resolution
constexpr double kMotorLow = 158.0, kMotorHigh = 2047.0;
constexpr double kQuaternionScale = 8127.0;
constexpr double kPolePairs = 7.0;
constexpr double kHundredRpm = 100.0 * kRpm;
constexpr int kIntraEvery = 32;  // frames

/// Names and unit of numbers of one kind.
struct Fields {
  std::string name;  ///< of NAME[0], NAME[1], ...; one alone has no brackets
  bool is_signed = true;
  double scale = 1.0;   ///< units of the log per ours
  double offset = 0.0;  ///< in units of the log
};

/// A stream's vectors at given stamps, linear between its samples.
class Line {
 public:
  void Add(Stamp stamp, const VectorXd& value) {
    stamps_.push_back(stamp);
    values_.push_back(value);
  }
  bool empty() const { return stamps_.empty(); }
  Stamp first() const { return stamps_.front(); }
  Stamp last() const { return stamps_.back(); }
  /// @pre first() <= stamp <= last(), and stamps asked for step forward
  VectorXd At(Stamp stamp) {
    while (next_ + 1 < stamps_.size() && stamps_[next_ + 1] <= stamp) ++next_;
    if (stamps_[next_] == stamp || next_ + 1 == stamps_.size()) return values_[next_];
    const double share = static_cast<double>(stamp - stamps_[next_]) /
                         static_cast<double>(stamps_[next_ + 1] - stamps_[next_]);
    return values_[next_] + share * (values_[next_ + 1] - values_[next_]);
  }

 private:
  std::vector<Stamp> stamps_;
  std::vector<VectorXd> values_;
  size_t next_ = 0;
};

/// What a frame holds: lines in the log's frames, with names and units.
struct Stream {
  Fields fields;
  Line line;
};

Stream Named(const std::string& name, bool is_signed, double scale, double offset = 0.0) {
  return {{name, is_signed, scale, offset}, {}};
}

/// Pose and velocity as INDIflight's observer logs them: north, west, up becomes NED and FRD.
void AddPoses(const FlightLog& log, std::vector<Stream>* streams) {
  if (log.odometry.empty()) return;
  Stream q = Named("quat", true, kQuaternionScale), p = Named("pos", true, 1e3),
         v = Named("vel", true, 1e2);
  for (const OdometrySample& s : log.odometry) {
    const Eigen::Quaterniond turn = NwuFromNed(s.q_WS);  // its own inverse
    q.line.Add(s.stamp, Eigen::Vector4d(turn.w(), turn.x(), turn.y(), turn.z()));
    p.line.Add(s.stamp, FluFromFrd(s.p_WS));
    if (s.v_WS) v.line.Add(s.stamp, FluFromFrd(*s.v_WS));
  }
  for (Stream* stream : {&q, &p, &v}) {
    if (!stream->line.empty()) streams->push_back(std::move(*stream));
  }
}

void AddImu(const std::vector<ImuSample>& imu, bool is_betaflight, std::vector<Stream>* streams) {
  Stream gyro = Named(is_betaflight ? "gyroADC" : "gyroADCafterRpm", true, kFine / kDegree);
  Stream acc =
      Named(is_betaflight ? "accSmooth" : "accUnfiltered", true, kOneG / kStandardGravity_m_s2);
  for (const ImuSample& s : imu) {
    if (s.gyro_I) gyro.line.Add(s.stamp, *s.gyro_I);
    if (s.specific_force_I) acc.line.Add(s.stamp, *s.specific_force_I);
  }
  for (Stream* stream : {&gyro, &acc}) {
    if (!stream->line.empty()) streams->push_back(std::move(*stream));
  }
}

void AddActuators(const FlightLog& log, bool is_betaflight, std::vector<Stream>* streams) {
  Stream motor = Named("motor", false, kMotorHigh - kMotorLow, kMotorLow);
  for (const CommandSample& s : log.commands) motor.line.Add(s.stamp, s.throttle);
  Stream speed = is_betaflight ? Named("eRPM", false, kPolePairs / kHundredRpm)
                               : Named("omegaUnfiltered", false, 1.0);
  for (const RotorSample& s : log.rotors) speed.line.Add(s.stamp, s.speed);
  Stream battery = Named("vbatLatest", false, 100.0);
  for (const BatterySample& s : log.battery) {
    battery.line.Add(s.stamp, VectorXd::Constant(1, s.voltage_V));
  }
  for (Stream* stream : {&motor, &speed, &battery}) {
    if (!stream->line.empty()) streams->push_back(std::move(*stream));
  }
}

/// One frame per sample of the IMU, else of the rotors, else of the commands.
std::vector<Stamp> FrameStamps(const FlightLog& log, const std::vector<ImuSample>& imu) {
  std::vector<Stamp> stamps;
  for (const ImuSample& s : imu) stamps.push_back(s.stamp);
  if (stamps.empty()) {
    for (const RotorSample& s : log.rotors) stamps.push_back(s.stamp);
  }
  if (stamps.empty()) {
    for (const CommandSample& s : log.commands) stamps.push_back(s.stamp);
  }
  return stamps;
}

/// Those where every stream is known.
std::vector<Stamp> CoveredBy(const std::vector<Stream>& streams, const std::vector<Stamp>& all) {
  std::vector<Stamp> covered;
  for (const Stamp stamp : all) {
    const bool has_all = std::all_of(streams.begin(), streams.end(), [stamp](const Stream& s) {
      return s.line.first() <= stamp && stamp <= s.line.last();
    });
    if (has_all) covered.push_back(stamp);
  }
  return covered;
}

/// Columns of whole numbers with their header, and frames of their differences.
class Writer {
 public:
  void AddColumn(const std::string& name, bool is_signed) {
    names_.push_back(name);
    signed_.push_back(is_signed);
  }

  void WriteHeader(bool is_betaflight) {
    const std::string firmware = is_betaflight ? "Betaflight 4.5.0" : "Indiflight 5.0.0";
    Line("Product", "Blackbox flight data recorder by Nicholas Sherlock");
    Line("Data version", "2");
    Line("I interval", std::to_string(kIntraEvery));
    Line("P interval", "1");
    Line("P ratio", std::to_string(kIntraEvery));
    Line("Firmware type", "Cleanflight");
    Line("Firmware revision", firmware + " (written by odmc convert)");
    Line("Field I name", List([this](size_t i) { return names_[i]; }));
    Line("Field I signed", List([this](size_t i) { return Number(signed_[i] ? 1 : 0); }));
    Line("Field I predictor", List([](size_t) { return Number(0); }));
    Line("Field I encoding", List([this](size_t i) { return Number(signed_[i] ? 0 : 1); }));
    // The loop counts on, time goes on as it did, everything else is near what it was.
    Line("Field P predictor", List([](size_t i) { return Number(i == 0 ? 6 : i == 1 ? 2 : 1); }));
    Line("Field P encoding", List([](size_t i) { return Number(i == 0 ? 9 : 0); }));
    Line("minthrottle", "1070");
    Line("maxthrottle", "2000");
    Line("gyro_scale", "0x3f800000");
    Line("motorOutput",
         Number(static_cast<int>(kMotorLow)) + "," + Number(static_cast<int>(kMotorHigh)));
    Line("acc_1G", Number(static_cast<int>(kOneG)));
    Line("vbatref", "0");
    Line("motor_poles", Number(static_cast<int>(2.0 * kPolePairs)));
    Line("blackbox_high_resolution", "1");
  }

  void WriteFrame(const std::vector<std::int64_t>& values) {
    const bool is_intra = frames_ % kIntraEvery == 0;
    out_.Text(is_intra ? "I" : "P");
    for (size_t i = is_intra ? 0 : 1; i < values.size(); ++i) {
      const std::int64_t predicted = is_intra ? 0 : i == 1 ? 2 * last_[1] - before_[1] : last_[i];
      is_intra && !signed_[i] ? Unsigned(static_cast<std::uint32_t>(values[i]))
                              : Signed(values[i] - predicted);
    }
    before_ = is_intra ? values : last_;
    last_ = values;
    ++frames_;
  }

  const std::string& Finish() {
    out_.Text(
        std::string_view("E\xff"
                         "End of log\0",
                         13));
    return out_.bytes();
  }

 private:
  static std::string Number(int value) { return std::to_string(value); }
  template <typename Get>
  std::string List(Get get) const {
    std::string text;
    for (size_t i = 0; i < names_.size(); ++i) text += (i == 0 ? "" : ",") + get(i);
    return text;
  }
  void Line(const std::string& name, const std::string& value) {
    out_.Text("H " + name + ":" + value + "\n");
  }
  /// Seven bits a byte, the lowest first.
  void Unsigned(std::uint32_t value) {
    for (; value > 0x7f; value >>= 7) out_.Number(static_cast<std::uint8_t>(value | 0x80));
    out_.Number(static_cast<std::uint8_t>(value));
  }
  /// Signs alternate: 0, -1, 1, -2, ...
  void Signed(std::int64_t value) {
    const auto word = static_cast<std::uint32_t>(value);
    Unsigned(word << 1 ^ (value < 0 ? 0xffffffffU : 0U));
  }

  std::vector<std::string> names_;
  std::vector<bool> signed_;
  std::vector<std::int64_t> last_, before_;
  long frames_ = 0;
  ByteWriter out_;
};

void DeclareColumns(const std::vector<Stream>& streams, Writer* writer) {
  writer->AddColumn("loopIteration", false);
  writer->AddColumn("time", false);
  for (const Stream& stream : streams) {
    const Eigen::Index count = Line(stream.line).At(stream.line.first()).size();
    for (Eigen::Index i = 0; i < count; ++i) {
      writer->AddColumn(
          count == 1 ? stream.fields.name : stream.fields.name + "[" + std::to_string(i) + "]",
          stream.fields.is_signed);
    }
  }
}

}  // namespace

void WriteBlackbox(const FlightLog& log, const std::string& file) {
  RotorsOf(log, file);
  const bool is_betaflight = log.odometry.empty();
  const std::vector<ImuSample> imu = ImuWithRates(log);
  std::vector<Stream> streams;
  AddPoses(log, &streams);
  AddImu(imu, is_betaflight, &streams);
  AddActuators(log, is_betaflight, &streams);
  const std::vector<Stamp> stamps = CoveredBy(streams, FrameStamps(log, imu));
  if (stamps.size() < 2) {
    RefuseFile(file, "the flight's streams are nowhere at the same time");
  }
  Writer writer;
  DeclareColumns(streams, &writer);
  writer.WriteHeader(is_betaflight);
  const Stamp shift = LogClockShift(log);
  std::vector<std::int64_t> values;
  for (size_t i = 0; i < stamps.size(); ++i) {
    values = {static_cast<std::int64_t>(i),
              static_cast<std::int64_t>(LogMicroseconds(stamps[i], shift))};
    for (Stream& stream : streams) {
      const VectorXd value = stream.line.At(stamps[i]);
      for (const double x : value) {
        const std::int64_t whole = std::llround(x * stream.fields.scale + stream.fields.offset);
        values.push_back(stream.fields.is_signed ? whole : std::max<std::int64_t>(whole, 0));
      }
    }
    writer.WriteFrame(values);
  }
  WriteBytes(writer.Finish(), file);
}

}  // namespace odmc
