#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstdint>
#include <cstring>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "odmc/sensing/samples.h"

namespace odmc {

/// \file
/// What the writers of autopilots' logs share.

/// Bytes in a row, numbers little-endian.
class ByteWriter {
 public:
  template <typename Value>
  ByteWriter& Number(Value value) {
    char raw[sizeof value];
    std::memcpy(raw, &value, sizeof value);
    bytes_.append(raw, sizeof value);
    return *this;
  }
  ByteWriter& Float(double value) { return Number(static_cast<float>(value)); }
  template <typename Vector>
  ByteWriter& Floats(const Vector& values) {
    for (Eigen::Index i = 0; i < values.size(); ++i) Float(values[i]);
    return *this;
  }
  ByteWriter& Text(std::string_view text) {
    bytes_.append(text);
    return *this;
  }
  /// A text in a field of `size` bytes, zeros behind it.
  ByteWriter& Padded(std::string_view text, size_t size) {
    bytes_.append(text.substr(0, size)).append(size - std::min(size, text.size()), '\0');
    return *this;
  }

  const std::string& bytes() const { return bytes_; }
  std::string& bytes() { return bytes_; }

 private:
  std::string bytes_;
};

/// Whole seconds that bring the flight's first stamp to 1 s to 2 s.
Stamp LogClockShift(const FlightLog& log);

/// Microseconds of the autopilot's clock.
inline std::uint64_t LogMicroseconds(Stamp stamp, Stamp shift) {
  return static_cast<std::uint64_t>((stamp + shift + 500) / 1000);
}

/// The vector; NaN where it was not measured.
Eigen::Vector3d OrNan(const std::optional<Eigen::Vector3d>& v);

/// Rotors of the flight, by its speeds or commands.
/// @throws std::invalid_argument where it has neither
int RotorsOf(const FlightLog& log, const std::string& file);

/// The IMU; body rates of the odometry where no sample has a gyro (body and IMU are then one
/// frame).
std::vector<ImuSample> ImuWithRates(const FlightLog& log);

/// Calls writers of several streams in the order of their stamps; of equal ones, in that of Add().
class StampOrder {
 public:
  template <typename Sample, typename Write>
  void Add(const std::vector<Sample>& samples, Write write) {
    streams_.push_back({0, samples.size(), [&samples](size_t i) { return samples[i].stamp; },
                        [&samples, write](size_t i) { write(samples[i]); }});
  }
  void WriteAll();

 private:
  struct Stream {
    size_t next, size;
    std::function<Stamp(size_t)> stamp;
    std::function<void(size_t)> write;
  };
  std::vector<Stream> streams_;
};

/// @throws std::runtime_error where it cannot be written
void WriteBytes(const std::string& bytes, const std::string& file);

}  // namespace odmc
