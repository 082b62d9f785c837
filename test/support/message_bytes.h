#pragma once

#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

namespace odmc::testing_support {

/// \file
/// Messages of packages that are not installed: their definitions as connections carry them, and
/// their bytes by hand.

const std::string kDependency(80, '=');

inline std::string With(const std::string& definition, const std::string& type,
                        const std::string& fields) {
  return definition + kDependency + "\nMSG: " + type + "\n" + fields;
}

inline std::string WithHeader(const std::string& definition) {
  return With(definition, "std_msgs/Header",
              "# a comment = none\nuint32 seq\ntime stamp\nstring frame_id\n");
}

inline std::string ActuatorsDefinition() {
  return WithHeader(
      "std_msgs/Header header\n\nfloat64[] angles             # Angle of the actuator in [rad].\n"
      "float64[] angular_velocities # in [rad/s].\nfloat64[] normalized\n");
}

inline std::string EscStatusDefinition() {
  return With(WithHeader("# ESCStatus.msg\n\nstd_msgs/Header header\n\n"
                         "mavros_msgs/ESCStatusItem[] esc_status\n"),
              "mavros_msgs/ESCStatusItem",
              "std_msgs/Header header\n\nint32 rpm\nfloat32 voltage\nfloat32 current\n");
}

inline std::string MotorRpmDefinition() {
  return WithHeader("Header header\ntime[] sample_stamp\nfloat32[] rpm\n");
}

/// Little-endian bytes of a message, field by field.
class MessageBytes {
 public:
  template <typename Number>
  MessageBytes& Add(Number value) {
    const size_t at = bytes_.size();
    bytes_.resize(at + sizeof value);
    std::memcpy(bytes_.data() + at, &value, sizeof value);
    return *this;
  }
  template <typename Number>
  MessageBytes& AddArray(const std::vector<Number>& values) {
    Add(static_cast<std::uint32_t>(values.size()));
    for (const Number value : values) Add(value);
    return *this;
  }
  MessageBytes& AddText(const std::string& text) {
    Add(static_cast<std::uint32_t>(text.size()));
    bytes_.insert(bytes_.end(), text.begin(), text.end());
    return *this;
  }
  /// A time or duration.
  MessageBytes& AddStamp(std::int64_t ns) {
    return Add(static_cast<std::int32_t>(ns / 1000000000))
        .Add(static_cast<std::int32_t>(ns % 1000000000));
  }
  MessageBytes& AddHeader(std::int64_t ns, const std::string& frame = "base_link") {
    return Add(std::uint32_t{7}).AddStamp(ns).AddText(frame);
  }

  const std::uint8_t* data() const { return bytes_.data(); }
  size_t size() const { return bytes_.size(); }
  const std::vector<std::uint8_t>& bytes() const { return bytes_; }

 private:
  std::vector<std::uint8_t> bytes_;
};

inline MessageBytes Actuators(std::int64_t ns, const std::vector<double>& speeds,
                              const std::vector<double>& normalized = {}) {
  MessageBytes bytes;
  bytes.AddHeader(ns).AddArray<double>({}).AddArray(speeds).AddArray(normalized);
  return bytes;
}

inline MessageBytes EscStatus(std::int64_t ns, const std::vector<std::int32_t>& rpm) {
  MessageBytes bytes;
  bytes.AddHeader(ns, "").Add(static_cast<std::uint32_t>(rpm.size()));
  for (const std::int32_t value : rpm)
    bytes.AddHeader(ns + 1, "esc").Add(value).Add(15.5f).Add(2.f);
  return bytes;
}

inline MessageBytes MotorRpm(std::int64_t ns, const std::vector<std::int64_t>& stamps,
                             const std::vector<float>& rpm) {
  MessageBytes bytes;
  bytes.AddHeader(ns, "").Add(static_cast<std::uint32_t>(stamps.size()));
  for (const std::int64_t stamp : stamps) bytes.AddStamp(stamp);
  bytes.AddArray(rpm);
  return bytes;
}

}  // namespace odmc::testing_support
