#include <rosbag/bag.h>
#include <std_msgs/Int64.h>

#include <algorithm>
#include <functional>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "odmc/ros/flight_bag.h"
#include "odmc/ros/message_values.h"
#include "odmc/ros/sample_messages.h"
#include "stamp_shift.h"

namespace odmc {
namespace {

constexpr char kWorldFrame[] = "world", kImuFrame[] = "imu_link";

/// The velocity stays in the world, since turning it into the body would change its last bits; the
/// child_frame_id says so (ResolveTwistFrame()). Body rates are in the odometry's own frame.
nav_msgs::Odometry InWorld(const OdometrySample& sample) {
  nav_msgs::Odometry m = ToMessage(sample, kWorldFrame, kWorldFrame);
  if (sample.v_WS) m.twist.twist.linear = ToVector3(*sample.v_WS);
  return m;
}

template <typename Sample>
void LowerTo(const std::vector<Sample>& samples, Stamp* earliest) {
  for (const Sample& sample : samples) *earliest = std::min(*earliest, sample.stamp);
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
      Sample sample = samples[i];
      sample.stamp = stamp;
      bag_->write(topic, ToRos(stamp), convert(sample));
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
  const auto convert = [](const auto& sample) { return ToMessage(sample); };
  OrderedWriter writer(bag);
  writer.Add("/odometry", log.odometry, shift, InWorld);
  writer.Add("/imu", log.imu, shift,
             [](const ImuSample& sample) { return ToMessage(sample, kImuFrame); });
  writer.Add("/rotor_speeds", log.rotors, shift,
             [&](const RotorSample& sample) { return ToMessage(sample, log.rotor_rms_only); });
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
