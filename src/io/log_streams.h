#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "decoding_damage.h"
#include "odmc/io/flight_read_options.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// \file
/// What the readers of autopilots' logs share: frames, rotors on one clock, checks and rates.

/// A vector of a body frame x forward, y right, z down (FRD) in x forward, y left, z up (FLU).
/// The same turn takes north, east, down (NED) to north, west, up.
inline Eigen::Vector3d FluFromFrd(const Eigen::Vector3d& v) { return {v.x(), -v.y(), -v.z()}; }

/// Attitude of FRD in NED as that of FLU in north, west, up.
inline Eigen::Quaterniond NwuFromNed(const Eigen::Quaterniond& q) {
  return {q.w(), q.x(), -q.y(), -q.z()};
}

/// A vector of NED in east, north, up.
inline Eigen::Vector3d EnuFromNed(const Eigen::Vector3d& v) { return {v.y(), v.x(), -v.z()}; }

/// Attitude of FRD in NED as that of FLU in east, north, up.
Eigen::Quaterniond EnuFromNed(const Eigen::Quaterniond& q);

/// One rotor's speed readings with their own stamps [rad/s].
struct RotorReadings {
  std::vector<Stamp> stamps;  ///< strictly increasing
  std::vector<double> speeds;

  /// Adds a finite reading that steps forward in time; takes the last one back where its stamp
  /// alone leapt ahead.
  void Add(Stamp stamp, double speed);
};

/// Readings of ESCs that answer one after the other, as samples at the first rotor's stamps: the
/// others' speeds are linear between their neighbours there; nothing where one of them is silent
/// for more than four of its usual intervals.
std::vector<RotorSample> OnOneClock(const std::vector<RotorReadings>& rotors);

/// Attitude of the sensor in a log's world, in our frames.
struct AttitudeReading {
  Stamp stamp = 0;
  Eigen::Quaterniond q_WS = Eigen::Quaterniond::Identity();
};

/// Gives positions the attitude of their stamps, turned between the readings around them; drops
/// those without readings within 0.2 s, and what does not step forward in time (counted in `log`).
void JoinAttitudes(const std::vector<AttitudeReading>& readings,
                   std::vector<OdometrySample>* positions, FlightLog* log);

/// Adds what an IMU in FRD read; the part that is not finite is left out.
void AddImuReading(Stamp stamp, const Eigen::Vector3d& gyro, const Eigen::Vector3d& acc,
                   FlightLog* log);

/// Tells the user in the log's warnings.
/// @throws std::invalid_argument where most of the `bytes` could not be decoded
void ReportDamage(const std::string& file, const DecodingDamage& damage, size_t bytes,
                  FlightLog* log);

/// Lines for the user that say what to set where a stream is too slow.
struct RateHints {
  std::string pose, rotors, imu;
};

/// The usual rate of stamps, from the median of their steps [Hz]; 0 for fewer than two.
double UsualRate(std::vector<Stamp> stamps);

/// The same of a stream.
template <typename Sample>
double RateOf(const std::vector<Sample>& samples) {
  std::vector<Stamp> stamps;
  stamps.reserve(samples.size());
  for (const Sample& sample : samples) stamps.push_back(sample.stamp);
  return UsualRate(std::move(stamps));
}

/// Factor on an autopilot's rotor speeds where the user's poles replace those it reckoned with.
/// @param parameter  the autopilot's, which holds its number of poles
/// @throws std::invalid_argument where the log does not have it
double PoleScale(const std::string& file, const std::map<std::string, double>& parameters,
                 const std::string& parameter, std::optional<int> pole_pairs);

/// Brings every stream of a log in order and checks it, see autopilot_logs.h.
/// @param file  path, for errors
/// @param part  what of it is wanted
/// @throws std::invalid_argument as autopilot_logs.h says
void FinishLog(const std::string& file, const RateHints& hints, FlightPart part, FlightLog* log);

}  // namespace odmc
