#include "log_streams.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "odmc/math/statistics.h"
#include "odmc/sensing/flight_checks.h"
#include "odmc/text/format.h"
#include "odmc/text/refusal.h"

namespace odmc {
namespace {

constexpr double kLeastPoseRate_hz = 10.0;   // motion capture of the slowest kind
constexpr double kLeastRotorRate_hz = 50.0;  // rotors follow in some 20 to 50 ms
constexpr double kLeastImuRate_hz = 50.0;

std::string Hertz(double rate) { return Format(rate < 10.0 ? "%.1f Hz" : "%.0f Hz", rate); }

/// Drops what is not finite, and what does not step forward in time.
template <typename Sample, typename Test>
void KeepSound(const std::string& source, std::vector<Sample>* samples, Test is_finite,
               FlightLog* log) {
  RefusedSamples refusals;
  std::vector<Sample> kept;
  kept.reserve(samples->size());
  for (const Sample& sample : *samples) {
    if (is_finite(sample)) {
      kept.push_back(sample);
    } else {
      refusals.Add(Format("at %.3f s", ToSeconds(sample.stamp)));
    }
  }
  refusals.Report(source, "readings that are not finite", log);
  *samples = std::move(kept);
  KeepForward(source, samples, log);
}

/// True if a reading is off by a factor from both of its neighbours, which agree: no rotor doubles
/// its speed and is back one reading later, and an ESC that lost a pulse reads half or double.
bool IsSpike(double before, double value, double after) {
  constexpr double kTurning_rad_s = 100.0, kAgree = 1.25, kFactor = 2.0;
  const double low = std::min(before, after), high = std::max(before, after);
  return low > kTurning_rad_s && high < kAgree * low &&
         (value > kFactor * high || value < low / kFactor);
}

void DropSpikes(const std::string& source, FlightLog* log) {
  constexpr double kNeighbour_s = 0.05;
  const std::vector<RotorSample>& all = log->rotors;
  RefusedSamples refusals;
  std::vector<RotorSample> kept;
  kept.reserve(all.size());
  for (size_t i = 0; i < all.size(); ++i) {
    bool is_spike = false;
    const bool has_neighbours = i > 0 && i + 1 < all.size() &&
                                ToSeconds(all[i].stamp - all[i - 1].stamp) < kNeighbour_s &&
                                ToSeconds(all[i + 1].stamp - all[i].stamp) < kNeighbour_s;
    for (Eigen::Index j = 0; has_neighbours && j < all[i].speed.size(); ++j) {
      is_spike = is_spike || IsSpike(all[i - 1].speed[j], all[i].speed[j], all[i + 1].speed[j]);
    }
    if (is_spike) {
      refusals.Add(Format("at %.3f s", ToSeconds(all[i].stamp)));
    } else {
      kept.push_back(all[i]);
    }
  }
  refusals.Report(source, "readings in which a rotor leaps by a factor and is back", log);
  log->rotors = std::move(kept);
}

void RefuseSlow(const std::string& file, const std::string& what, double rate, double least,
                const std::string& hint) {
  if (rate >= 0.95 * least) return;
  RefuseFile(file, what + " are logged at " + Hertz(rate) + ", at least " + Hertz(least) +
                       " are needed: " + hint);
}

std::string RateText(const std::string& what, double rate) {
  return rate > 0.0 ? what + " " + Hertz(rate) : "no " + what;
}

void Describe(FlightLog* log) {
  log->warnings.push_back(
      log->file + ": read " +
      Listed({RateText("pose", RateOf(log->odometry)), RateText("IMU", RateOf(log->imu)),
              RateText("rotor speeds", RateOf(log->rotors)),
              RateText("commands", RateOf(log->commands)),
              RateText("battery voltage", RateOf(log->battery))}));
}

/// Speed of a rotor at `stamp`, linear between readings; `next` is where the last search ended.
bool SpeedAt(const RotorReadings& rotor, Stamp longest_gap, Stamp stamp, size_t* next,
             double* speed) {
  while (*next < rotor.stamps.size() && rotor.stamps[*next] < stamp) ++*next;
  if (*next == rotor.stamps.size()) return false;
  *speed = rotor.speeds[*next];
  if (rotor.stamps[*next] == stamp) return true;
  if (*next == 0) return false;
  const Stamp before = rotor.stamps[*next - 1], gap = rotor.stamps[*next] - before;
  if (gap > longest_gap) return false;
  const double share = static_cast<double>(stamp - before) / static_cast<double>(gap);
  *speed = rotor.speeds[*next - 1] + share * (*speed - rotor.speeds[*next - 1]);
  return true;
}

}  // namespace

Eigen::Quaterniond EnuFromNed(const Eigen::Quaterniond& q) {
  const Eigen::Quaterniond q_EnuNwu(std::sqrt(0.5), 0.0, 0.0, std::sqrt(0.5));  // 90 deg about up
  return q_EnuNwu * NwuFromNed(q);
}

double UsualRate(std::vector<Stamp> stamps) {
  if (stamps.size() < 2) return 0.0;
  for (size_t i = 0; i + 1 < stamps.size(); ++i) stamps[i] = stamps[i + 1] - stamps[i];
  stamps.pop_back();
  const Stamp step = MiddleOf(std::move(stamps));
  return step > 0 ? 1.0 / ToSeconds(step) : 0.0;
}

void RotorReadings::Add(Stamp stamp, double speed) {
  if (IsLoneLeap(stamps, stamp)) {
    stamps.pop_back();
    speeds.pop_back();
  }
  if (!std::isfinite(speed) || (!stamps.empty() && stamp <= stamps.back())) return;
  stamps.push_back(stamp);
  speeds.push_back(speed);
}

std::vector<RotorSample> OnOneClock(const std::vector<RotorReadings>& rotors) {
  std::vector<RotorSample> samples;
  if (rotors.empty()) return samples;
  constexpr double kLongest_s = 1e6;  // damaged stamps may ask for more than a Stamp holds
  std::vector<Stamp> longest_gaps;
  for (const RotorReadings& rotor : rotors) {
    const double rate = UsualRate(rotor.stamps);
    longest_gaps.push_back(rate > 0.0 ? FromSeconds(std::min(4.0 / rate, kLongest_s)) : 0);
  }
  std::vector<size_t> next(rotors.size(), 0);
  for (const Stamp stamp : rotors[0].stamps) {
    RotorSample sample;
    sample.stamp = stamp;
    sample.speed.resize(static_cast<Eigen::Index>(rotors.size()));
    bool has_all = true;
    for (size_t j = 0; j < rotors.size(); ++j) {
      double speed = 0.0;
      has_all = SpeedAt(rotors[j], longest_gaps[j], stamp, &next[j], &speed) && has_all;
      sample.speed[static_cast<Eigen::Index>(j)] = speed;
    }
    if (has_all) samples.push_back(sample);
  }
  return samples;
}

namespace {

/// Finite ones that step forward in time, without single ones that leapt ahead.
std::vector<AttitudeReading> Forward(const std::vector<AttitudeReading>& all) {
  std::vector<AttitudeReading> kept;
  std::vector<Stamp> stamps;
  for (const AttitudeReading& reading : all) {
    if (IsLoneLeap(stamps, reading.stamp)) {
      stamps.pop_back();
      kept.pop_back();
    }
    const bool steps = stamps.empty() || reading.stamp > stamps.back();
    if (!steps || !reading.q_WS.coeffs().allFinite()) continue;
    stamps.push_back(reading.stamp);
    kept.push_back(reading);
  }
  return kept;
}

}  // namespace

void JoinAttitudes(const std::vector<AttitudeReading>& readings,
                   std::vector<OdometrySample>* positions, FlightLog* log) {
  KeepForward(log->file + ": pose", positions, log);
  const std::vector<AttitudeReading> attitudes = Forward(readings);
  constexpr double kLongest_s = 0.2;
  std::vector<OdometrySample> kept;
  size_t next = 0;
  for (OdometrySample& sample : *positions) {
    while (next < attitudes.size() && attitudes[next].stamp < sample.stamp) ++next;
    if (next == attitudes.size()) break;
    const AttitudeReading& after = attitudes[next];
    if (after.stamp == sample.stamp) {
      sample.q_WS = after.q_WS;
      kept.push_back(sample);
      continue;
    }
    if (next == 0 || ToSeconds(after.stamp - attitudes[next - 1].stamp) > kLongest_s) continue;
    const AttitudeReading& before = attitudes[next - 1];
    const double share = static_cast<double>(sample.stamp - before.stamp) /
                         static_cast<double>(after.stamp - before.stamp);
    sample.q_WS = before.q_WS.slerp(share, after.q_WS);
    kept.push_back(sample);
  }
  *positions = std::move(kept);
}

void AddImuReading(Stamp stamp, const Eigen::Vector3d& gyro, const Eigen::Vector3d& acc,
                   FlightLog* log) {
  ImuSample sample;
  sample.stamp = stamp;
  if (gyro.allFinite()) sample.gyro_I = FluFromFrd(gyro);
  if (acc.allFinite()) sample.specific_force_I = FluFromFrd(acc);
  log->imu.push_back(sample);  // one that has neither is dropped and counted by FinishLog()
}

void ReportDamage(const std::string& file, const DecodingDamage& damage, size_t bytes,
                  FlightLog* log) {
  const std::string place = "byte " + std::to_string(damage.first);
  if (2 * damage.skipped > bytes) {
    RefuseFile(file, "most of it cannot be decoded, first at " + place);
  }
  if (damage.places > 0) {
    log->dropped += damage.places;
    log->warnings.push_back(log->file + ": damaged at " + std::to_string(damage.places) +
                            (damage.places == 1 ? " place" : " places, first") + " at " + place +
                            "; " + std::to_string(damage.skipped) + " bytes skipped");
  }
  if (damage.is_cut_off) log->warnings.push_back(log->file + ": ends within a record: cut off");
}

double PoleScale(const std::string& file, const std::map<std::string, double>& parameters,
                 const std::string& parameter, std::optional<int> pole_pairs) {
  if (!pole_pairs) return 1.0;
  const auto poles = parameters.find(parameter);
  if (poles == parameters.end() || !(poles->second >= 2.0)) {
    RefuseFile(file, "--pole-pairs: the log has no " + parameter +
                         " that was used instead; without --pole-pairs its speeds are "
                         "taken as they are");
  }
  return 0.5 * poles->second / *pole_pairs;
}

void FinishLog(const std::string& file, const RateHints& hints, FlightPart part, FlightLog* log) {
  KeepSound(
      log->file + ": pose", &log->odometry, [](const auto& s) { return IsFinite(s); }, log);
  KeepSound(
      log->file + ": IMU", &log->imu, [](const auto& s) { return IsFinite(s); }, log);
  KeepSound(
      log->file + ": rotor speeds", &log->rotors, [](const auto& s) { return s.speed.allFinite(); },
      log);
  KeepSound(
      log->file + ": commands", &log->commands,
      [](const auto& s) { return s.throttle.allFinite(); }, log);
  KeepSound(
      log->file + ": battery", &log->battery,
      [](const auto& s) { return std::isfinite(s.voltage_V); }, log);
  if (part != FlightPart::kOnboard) {
    if (log->odometry.empty()) RefuseFile(file, "has no usable pose");
    RefuseSlow(file, "poses", RateOf(log->odometry), kLeastPoseRate_hz, hints.pose);
  }
  if (!log->odometry.empty()) NormaliseAttitudes(file, &log->odometry, log);
  if (part == FlightPart::kPoses) return;
  if (!log->rotors.empty()) {
    RefuseSlow(file, "rotor speeds", RateOf(log->rotors), kLeastRotorRate_hz, hints.rotors);
  }
  if (log->rotors.empty()) {
    RefuseSlow(file, "commands", RateOf(log->commands), kLeastRotorRate_hz, hints.rotors);
  }
  const double imu_rate = RateOf(log->imu);
  Describe(log);
  if (!log->imu.empty() && imu_rate < 0.95 * kLeastImuRate_hz) {
    log->imu.clear();
    log->warnings.push_back(log->file + ": the IMU is logged at " + Hertz(imu_rate) +
                            ", too slow to be used: " + hints.imu);
  }
  TakeSpeedMagnitudes(log->file, log);
  DropSpikes(log->file, log);
  WarnOfDeadRotors(log->file, log);
}

}  // namespace odmc
