#include <cmath>
#include <limits>

#include "log_streams.h"
#include "log_writing.h"
#include "odmc/io/autopilot_log_writers.h"
#include "odmc/math/units.h"

namespace odmc {
namespace {

using Eigen::Vector3d;

constexpr int kMotor1 = 101;                      // actuator_function of an ESC
constexpr int kLeastEscs = 8, kLeastMotors = 12;  // array lengths of PX4's messages
constexpr std::int32_t kPoles = 14;
constexpr std::uint8_t kNed = 1;

/// Topics, by the number their messages carry.
enum Topic : std::uint16_t { kOdometry, kImu, kEscs, kMotors, kBattery };

class Writer {
 public:
  Writer(const FlightLog& log, int num_rotors)
      : shift_(LogClockShift(log)),
        num_rotors_(num_rotors),
        num_escs_(std::max(num_rotors, kLeastEscs)),
        num_motors_(std::max(num_rotors, kLeastMotors)) {}

  /// File header, flags, what the log is from, and all definitions.
  void WriteDefinitions() {
    out_.Text(std::string_view("ULog\x01\x12\x35\x01", 8)).Number(std::uint64_t{1000000});
    Message('B', ByteWriter().Padded("", 40));
    const std::string escs = std::to_string(num_escs_), motors = std::to_string(num_motors_);
    for (const std::string& text : {
             std::string("vehicle_odometry:uint64_t timestamp;uint64_t timestamp_sample;float[3] "
                         "position;float[4] q;float[3] velocity;float[3] angular_velocity;uint8_t "
                         "pose_frame;uint8_t velocity_frame;"),
             std::string("sensor_combined:uint64_t timestamp;float[3] gyro_rad;float[3] "
                         "accelerometer_m_s2;"),
             std::string("esc_report:uint64_t timestamp;int32_t esc_rpm;uint8_t "
                         "actuator_function;uint8_t[3] _padding0;"),
             "esc_status:uint64_t timestamp;esc_report[" + escs + "] esc;uint8_t esc_count;",
             "actuator_motors:uint64_t timestamp;uint64_t timestamp_sample;float[" + motors +
                 "] control;",
             std::string("battery_status:uint64_t timestamp;float voltage_v;"),
         }) {
      Message('F', ByteWriter().Text(text));
    }
    Keyed('I', "char[3] sys_name", ByteWriter().Text("PX4"));
    Keyed('I', "char[12] ver_sw_source", ByteWriter().Text("odmc convert"));
    Keyed('P', "int32_t MOT_POLE_COUNT", ByteWriter().Number(kPoles));
  }

  void Subscribe() {
    std::uint16_t number = 0;
    for (const char* name : {"vehicle_odometry", "sensor_combined", "esc_status", "actuator_motors",
                             "battery_status"}) {
      Message('A', ByteWriter().Number(std::uint8_t{0}).Number(number++).Text(name));
    }
  }

  void Write(const OdometrySample& s) {
    const Eigen::Quaterniond q = EnuFromNed(s.q_WS);  // the turn is its own inverse
    ByteWriter data = Data(kOdometry, s.stamp, true);
    data.Floats(EnuFromNed(s.p_WS)).Floats(Eigen::Vector4d(q.w(), q.x(), q.y(), q.z()));
    data.Floats(EnuFromNed(OrNan(s.v_WS))).Floats(FluFromFrd(OrNan(s.w_WS_S)));
    data.Number(kNed).Number(kNed);
    Message('D', data);
  }
  void Write(const ImuSample& s) {
    Message('D', Data(kImu, s.stamp, false)
                     .Floats(FluFromFrd(OrNan(s.gyro_I)))
                     .Floats(FluFromFrd(OrNan(s.specific_force_I))));
  }
  void Write(const RotorSample& s) {
    ByteWriter data = Data(kEscs, s.stamp, false);
    for (int j = 0; j < num_escs_; ++j) {
      const bool is_there = j < num_rotors_;
      data.Number(is_there ? LogMicroseconds(s.stamp, shift_) : std::uint64_t{0})
          .Number(static_cast<std::int32_t>(is_there ? std::lround(s.speed[j] / kRpm) : 0))
          .Number(static_cast<std::uint8_t>(is_there ? kMotor1 + j : 0))
          .Padded("", 3);
    }
    Message('D', data.Number(static_cast<std::uint8_t>(num_rotors_)));
  }
  void Write(const CommandSample& s) {
    ByteWriter data = Data(kMotors, s.stamp, true);
    for (int j = 0; j < num_motors_; ++j) {
      data.Float(j < num_rotors_ ? s.throttle[j] : std::numeric_limits<double>::quiet_NaN());
    }
    Message('D', data);
  }
  void Write(const BatterySample& s) {
    Message('D', Data(kBattery, s.stamp, false).Float(s.voltage_V));
  }

  const std::string& bytes() const { return out_.bytes(); }

 private:
  ByteWriter Data(std::uint16_t topic, Stamp stamp, bool with_sample) const {
    ByteWriter data;
    data.Number(topic).Number(LogMicroseconds(stamp, shift_));
    if (with_sample) data.Number(LogMicroseconds(stamp, shift_));
    return data;
  }
  void Message(char kind, const ByteWriter& body) {
    out_.Number(static_cast<std::uint16_t>(body.bytes().size())).Number(kind).Text(body.bytes());
  }
  void Keyed(char kind, std::string_view key, const ByteWriter& value) {
    Message(
        kind,
        ByteWriter().Number(static_cast<std::uint8_t>(key.size())).Text(key).Text(value.bytes()));
  }

  Stamp shift_;
  int num_rotors_, num_escs_, num_motors_;
  ByteWriter out_;
};

}  // namespace

void WriteULog(const FlightLog& log, const std::string& file) {
  Writer writer(log, RotorsOf(log, file));
  writer.WriteDefinitions();
  writer.Subscribe();
  StampOrder order;
  const auto write = [&writer](const auto& sample) { writer.Write(sample); };
  order.Add(log.odometry, write);
  order.Add(log.imu, write);
  order.Add(log.rotors, write);
  order.Add(log.commands, write);
  order.Add(log.battery, write);
  order.WriteAll();
  WriteBytes(writer.bytes(), file);
}

}  // namespace odmc
