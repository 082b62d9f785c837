#include "log_writing.h"

#include <fstream>
#include <limits>
#include <stdexcept>

#include "odmc/text/refusal.h"

namespace odmc {
namespace {

constexpr Stamp kSecond = 1000000000;

template <typename Sample>
void Lower(const std::vector<Sample>& samples, Stamp* earliest) {
  if (!samples.empty()) *earliest = std::min(*earliest, samples.front().stamp);
}

}  // namespace

Stamp LogClockShift(const FlightLog& log) {
  Stamp earliest = std::numeric_limits<Stamp>::max();
  Lower(log.odometry, &earliest);
  Lower(log.imu, &earliest);
  Lower(log.rotors, &earliest);
  Lower(log.battery, &earliest);
  Lower(log.commands, &earliest);
  if (earliest == std::numeric_limits<Stamp>::max()) return 0;
  const Stamp whole = earliest >= 0 ? earliest / kSecond : -((-earliest + kSecond - 1) / kSecond);
  return (1 - whole) * kSecond;
}

Eigen::Vector3d OrNan(const std::optional<Eigen::Vector3d>& v) {
  return v.value_or(Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN()));
}

int RotorsOf(const FlightLog& log, const std::string& file) {
  if (!log.rotors.empty()) return static_cast<int>(log.rotors.front().speed.size());
  if (!log.commands.empty()) return static_cast<int>(log.commands.front().throttle.size());
  RefuseFile(file, "the flight has neither rotor speeds nor commands to write");
}

std::vector<ImuSample> ImuWithRates(const FlightLog& log) {
  const bool has_gyro = std::any_of(log.imu.begin(), log.imu.end(),
                                    [](const ImuSample& s) { return s.gyro_I.has_value(); });
  std::vector<ImuSample> imu = log.imu;
  if (has_gyro) return imu;
  for (const OdometrySample& s : log.odometry) {
    if (s.w_WS_S) imu.push_back({s.stamp, s.w_WS_S, std::nullopt});
  }
  std::stable_sort(imu.begin(), imu.end(),
                   [](const ImuSample& a, const ImuSample& b) { return a.stamp < b.stamp; });
  std::vector<ImuSample> merged;  // both of one moment are one sample
  for (const ImuSample& sample : imu) {
    if (!merged.empty() && merged.back().stamp == sample.stamp) {
      if (sample.gyro_I) merged.back().gyro_I = sample.gyro_I;
    } else {
      merged.push_back(sample);
    }
  }
  return merged;
}

void StampOrder::WriteAll() {
  while (true) {
    Stream* earliest = nullptr;
    for (Stream& s : streams_) {
      if (s.next == s.size) continue;
      if (earliest == nullptr || s.stamp(s.next) < earliest->stamp(earliest->next)) earliest = &s;
    }
    if (earliest == nullptr) return;
    earliest->write(earliest->next++);
  }
}

void WriteBytes(const std::string& bytes, const std::string& file) {
  std::ofstream out(file, std::ios::binary);
  out.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  out.close();
  if (!out) throw std::runtime_error(file + ": cannot be written");
}

}  // namespace odmc
