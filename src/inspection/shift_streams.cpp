#include <algorithm>
#include <cmath>
#include <optional>

#include "odmc/inspection/stream_inspection.h"

namespace odmc {
namespace {

using Eigen::Vector3d;
using Member = std::optional<Vector3d> OdometrySample::*;

constexpr double kLongestLine_s = 0.1;  // between samples that a line may join
constexpr double kMostLost = 0.2;       // share of the poses

template <typename Sample>
void ShiftStamps(double late_s, std::vector<Sample>* samples) {
  const Stamp late = FromSeconds(late_s);
  for (Sample& sample : *samples) sample.stamp -= late;
}

/// Value of a member at `stamp`, on the cubic through the four samples around it (a line would take
/// a fifth of what moves with a fifth of the rate), or on the line between two where four are not
/// there.
std::optional<Vector3d> Between(const std::vector<OdometrySample>& samples, Member member,
                                Stamp stamp, size_t* at) {
  while (*at + 1 < samples.size() && samples[*at + 1].stamp <= stamp) ++*at;
  if (samples[*at].stamp > stamp || *at + 1 >= samples.size()) return std::nullopt;
  const auto whole = [&](size_t first, size_t last) {
    for (size_t i = first; i <= last; ++i) {
      if (!(samples[i].*member)) return false;
      if (i > first && ToSeconds(samples[i].stamp - samples[i - 1].stamp) > kLongestLine_s)
        return false;
    }
    return true;
  };
  size_t first = *at, last = *at + 1;
  if (!whole(first, last)) return std::nullopt;
  if (first > 0 && last + 1 < samples.size() && whole(first - 1, last + 1)) {
    --first;
    ++last;
  }
  Vector3d value = Vector3d::Zero();  // Lagrange's form
  for (size_t i = first; i <= last; ++i) {
    double weight = 1.0;
    for (size_t j = first; j <= last; ++j) {
      if (j == i) continue;
      weight *=
          ToSeconds(stamp - samples[j].stamp) / ToSeconds(samples[i].stamp - samples[j].stamp);
    }
    value += weight * *(samples[i].*member);
  }
  return value;
}

/// A reading stamped t + late was taken at t: every pose gets what stands `late_s` after it.
void ShiftMember(double late_s, Member member, FlightLog* log) {
  const std::vector<OdometrySample> recorded = log->odometry;
  const Stamp late = FromSeconds(late_s);
  std::vector<OdometrySample> shifted;
  size_t at = 0;
  for (OdometrySample sample : recorded) {
    const bool had = (sample.*member).has_value();
    sample.*member = Between(recorded, member, sample.stamp + late, &at);
    if ((sample.*member).has_value() || !had) shifted.push_back(sample);
  }
  const auto lost = static_cast<double>(recorded.size() - shifted.size());
  if (lost <= kMostLost * static_cast<double>(recorded.size())) {
    log->odometry = std::move(shifted);
    return;
  }
  for (OdometrySample& sample : log->odometry) (sample.*member).reset();
}

void Drop(const StreamInspection& inspection, FlightLog* log) {
  for (OdometrySample& sample : log->odometry) {
    if (inspection.drop_velocity) sample.v_WS.reset();
    if (inspection.drop_rates) sample.w_WS_S.reset();
  }
  for (ImuSample& sample : log->imu) {
    if (inspection.drop_gyro) sample.gyro_I.reset();
    if (inspection.drop_accelerometer) sample.specific_force_I.reset();
  }
  auto& imu = log->imu;
  imu.erase(std::remove_if(imu.begin(), imu.end(),
                           [](const ImuSample& s) { return !s.gyro_I && !s.specific_force_I; }),
            imu.end());
}

}  // namespace

void ShiftRotors(double late_s, FlightLog* log) { ShiftStamps(late_s, &log->rotors); }
void ShiftImu(double late_s, FlightLog* log) { ShiftStamps(late_s, &log->imu); }
void ShiftVelocity(double late_s, FlightLog* log) {
  ShiftMember(late_s, &OdometrySample::v_WS, log);
}
void ShiftRates(double late_s, FlightLog* log) {
  ShiftMember(late_s, &OdometrySample::w_WS_S, log);
}

void ShiftStream(const std::string& stream, double late_s, FlightLog* log) {
  if (stream == "rotor_speeds") ShiftRotors(late_s, log);
  if (stream == "velocity") ShiftVelocity(late_s, log);
  if (stream == "body_rates") ShiftRates(late_s, log);
  if (stream == "gyro" || stream == "accelerometer") ShiftImu(late_s, log);
}

void MendStreams(const StreamInspection& inspection, FlightLog* log) {
  Drop(inspection, log);
  for (const TimeOffset& offset : inspection.offsets) {
    if (offset.compensated_s != 0.0) ShiftStream(offset.stream, offset.compensated_s, log);
  }
}

}  // namespace odmc
