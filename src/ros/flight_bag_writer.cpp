#include <nav_msgs/Odometry.h>
#include <rosbag/bag.h>
#include <sensor_msgs/BatteryState.h>
#include <sensor_msgs/Imu.h>
#include <std_msgs/Int64.h>

#include <algorithm>
#include <functional>
#include <limits>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "odmc/MotorCommands.h"
#include "odmc/RotorSpeeds.h"
#include "odmc/ros/flight_bag.h"
#include "odmc/ros/message_values.h"
#include "stamp_shift.h"

namespace odmc {
namespace {

constexpr char kWorldFrame[] = "world";

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
