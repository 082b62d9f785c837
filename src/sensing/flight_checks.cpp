#include "odmc/sensing/flight_checks.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "odmc/math/statistics.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

constexpr double kNormTolerance = 0.05;
constexpr double kTurning_rad_s = 20.0;  // slower ones may rightly read zero
constexpr double kStuck_s = 0.5;         // longer than any filter or slow update holds a value
constexpr int kChanges = 10;             // of the others, meanwhile
constexpr char kWrong[] = "what is estimated from this flight is wrong";
constexpr double kStandingThrottle = 0.02;  // below what turns a rotor
constexpr double kSpoolUp_s = 0.2;          // until a rotor that is told to turn reads something
constexpr double kDeadShare = 0.05;         // single missed readings are not worth a warning

std::string AtSeconds(Stamp stamp) { return Format("at %.3f s", ToSeconds(stamp)); }

/// Median of all rotors but `skip`.
double MedianOfOthers(const RotorVector& speed, Eigen::Index skip) {
  std::vector<double> others;
  for (Eigen::Index j = 0; j < speed.size(); ++j) {
    if (j != skip) others.push_back(speed[j]);
  }
  return MiddleOf(std::move(others));
}

bool OthersChanged(const RotorVector& a, const RotorVector& b, Eigen::Index skip) {
  for (Eigen::Index j = 0; j < a.size(); ++j) {
    if (j != skip && a[j] != b[j]) return true;
  }
  return false;
}

/// How many samples of rotor `j` repeat one value for kStuck_s while others change.
long CountStuck(const std::vector<RotorSample>& rotors, Eigen::Index j) {
  long stuck = 0;
  size_t begin = 0;
  int changes = 0;
  for (size_t i = 1; i <= rotors.size(); ++i) {
    if (i < rotors.size() && rotors[i].speed[j] == rotors[begin].speed[j]) {
      if (OthersChanged(rotors[i].speed, rotors[i - 1].speed, j)) ++changes;
      continue;
    }
    const bool turns = rotors[begin].speed[j] >= kTurning_rad_s;  // zero is counted apart
    if (turns && changes >= kChanges &&
        ToSeconds(rotors[i - 1].stamp - rotors[begin].stamp) >= kStuck_s) {
      stuck += static_cast<long>(i - begin);
    }
    begin = i;
    changes = 0;
  }
  return stuck;
}

struct DeadCount {
  long turning = 0;  ///< samples in which the other rotors turn
  long zero = 0;     ///< of these, samples in which this one reads (almost) zero
};

/// Commands in the order of the stamps they are asked for.
class Commanded {
 public:
  explicit Commanded(const std::vector<CommandSample>& commands) : commands_(commands) {}

  /// True if rotor `j` was told to stand within the time it takes to spool up before `stamp`.
  bool Stands(Stamp stamp, Eigen::Index j) {
    while (next_ < commands_.size() && commands_[next_].stamp <= stamp) {
      const CommandSample& command = commands_[next_++];
      if (j < command.throttle.size() && command.throttle[j] < kStandingThrottle) {
        last_standing_ = command.stamp;
        told_ = true;
      }
    }
    return told_ && ToSeconds(stamp - last_standing_) < kSpoolUp_s;
  }

 private:
  const std::vector<CommandSample>& commands_;
  size_t next_ = 0;
  Stamp last_standing_ = 0;
  bool told_ = false;
};

DeadCount CountZero(const FlightLog& log, Eigen::Index j) {
  DeadCount count;
  Commanded commanded(log.commands);
  for (const RotorSample& sample : log.rotors) {
    const double others = MedianOfOthers(sample.speed, j);
    if (commanded.Stands(sample.stamp, j) || others < kTurning_rad_s) continue;
    ++count.turning;
    if (sample.speed[j] < 0.02 * others) ++count.zero;
  }
  return count;
}

void WarnIfShare(const std::string& source, Eigen::Index j, long bad, long all,
                 const std::string& what, FlightLog* log) {
  const double share = all > 0 ? static_cast<double>(bad) / static_cast<double>(all) : 0.0;
  if (share < kDeadShare) return;
  const std::string text = Format(
      "rotor%d %s in %.0f %% of the samples while the others turn: its sensor or the "
      "rotor is dead, and %s",
      static_cast<int>(j) + 1, what.c_str(), 100.0 * share, kWrong);
  log->warnings.push_back(source + ": " + text);
}

}  // namespace

bool IsFinite(const OdometrySample& s) {
  return s.p_WS.allFinite() && s.q_WS.coeffs().allFinite() && (!s.v_WS || s.v_WS->allFinite()) &&
         (!s.w_WS_S || s.w_WS_S->allFinite());
}

bool IsFinite(const ImuSample& s) {
  return (s.gyro_I || s.specific_force_I) && (!s.gyro_I || s.gyro_I->allFinite()) &&
         (!s.specific_force_I || s.specific_force_I->allFinite());
}

bool IsSamePose(const OdometrySample& a, const OdometrySample& b) {
  return a.p_WS == b.p_WS && a.q_WS.coeffs() == b.q_WS.coeffs();
}

void RefusedSamples::Report(const std::string& source, const std::string& what,
                            FlightLog* log) const {
  if (count == 0) return;
  log->dropped += count;
  log->warnings.push_back(source + ": dropped " + std::to_string(count) + " " + what +
                          " (first: " + first + ")");
}

namespace {

constexpr Stamp kLeap = 1000000000;  // [ns]: no sensor that is in use is silent for longer

bool IsLoneLeap(Stamp before, Stamp last, Stamp next) {
  return last - before > kLeap && next > before && next - before < (last - before) / 2;
}

}  // namespace

bool IsLoneLeap(const std::vector<Stamp>& stamps, Stamp next) {
  if (stamps.empty()) return false;
  return stamps.size() == 1 ? stamps.back() - next > kLeap
                            : IsLoneLeap(stamps[stamps.size() - 2], stamps.back(), next);
}

template <typename Sample>
void KeepForward(const std::string& source, std::vector<Sample>* samples, FlightLog* log) {
  std::vector<Sample> kept;
  kept.reserve(samples->size());
  std::vector<Stamp> stamps;  // of those kept
  stamps.reserve(samples->size());
  RefusedSamples refusals, leaps;
  for (const Sample& sample : *samples) {
    if (IsLoneLeap(stamps, sample.stamp)) {
      leaps.Add(AtSeconds(stamps.back()));
      stamps.pop_back();
      kept.pop_back();
    }
    if (kept.empty() || sample.stamp > kept.back().stamp) {
      kept.push_back(sample);
      stamps.push_back(sample.stamp);
    } else {
      refusals.Add(AtSeconds(sample.stamp));
    }
  }
  if (2 * kept.size() < samples->size()) {
    throw std::invalid_argument(
        source + ": stamps step back or repeat in " + std::to_string(refusals.count) + " of " +
        std::to_string(samples->size()) + " samples (first: " + refusals.first + ")");
  }
  leaps.Report(source, "samples whose stamp leaps ahead of all after it", log);
  refusals.Report(source, "samples whose stamp steps back or repeats", log);
  *samples = std::move(kept);
}

template void KeepForward(const std::string&, std::vector<OdometrySample>*, FlightLog*);
template void KeepForward(const std::string&, std::vector<ImuSample>*, FlightLog*);
template void KeepForward(const std::string&, std::vector<RotorSample>*, FlightLog*);
template void KeepForward(const std::string&, std::vector<BatterySample>*, FlightLog*);
template void KeepForward(const std::string&, std::vector<CommandSample>*, FlightLog*);

void NormaliseAttitudes(const std::string& source, std::vector<OdometrySample>* samples,
                        FlightLog* log) {
  std::vector<OdometrySample> kept;
  kept.reserve(samples->size());
  RefusedSamples refusals;
  for (OdometrySample sample : *samples) {
    const double norm = sample.q_WS.norm();
    if (!(std::abs(norm - 1.0) <= kNormTolerance)) {
      refusals.Add(AtSeconds(sample.stamp) + ", norm " + std::to_string(norm));
      continue;
    }
    if (std::abs(sample.q_WS.squaredNorm() - 1.0) > 2e-15) sample.q_WS.normalize();
    if (!kept.empty() && kept.back().q_WS.dot(sample.q_WS) < 0.0) {
      sample.q_WS.coeffs() = -sample.q_WS.coeffs();
    }
    kept.push_back(sample);
  }
  if (2 * kept.size() < samples->size()) {
    throw std::invalid_argument(
        source + ": the quaternions are not unit: " + std::to_string(refusals.count) + " of " +
        std::to_string(samples->size()) + " are off by more than 5 % (first: " + refusals.first +
        "); is their order qw, qx, qy, qz?");
  }
  refusals.Report(source, "samples whose quaternion is not unit", log);
  *samples = std::move(kept);
}

void TakeSpeedMagnitudes(const std::string& source, FlightLog* log) {
  long negative = 0;
  for (RotorSample& sample : log->rotors) {
    if ((sample.speed.array() >= 0.0).all()) continue;
    sample.speed = sample.speed.cwiseAbs();
    ++negative;
  }
  if (negative == 0) return;
  log->warnings.push_back(source + ": " + std::to_string(negative) +
                          " samples have negative rotor speeds; their magnitude is used, the "
                          "direction of turning comes from the vehicle file");
}

void WarnOfDeadRotors(const std::string& source, FlightLog* log) {
  if (log->rotor_rms_only || log->rotors.empty() || log->rotors.front().speed.size() < 2) return;
  for (Eigen::Index j = 0; j < log->rotors.front().speed.size(); ++j) {
    const DeadCount count = CountZero(*log, j);
    WarnIfShare(source, j, count.zero, count.turning, "reads zero", log);
    WarnIfShare(source, j, CountStuck(log->rotors, j), static_cast<long>(log->rotors.size()),
                "is stuck at one value", log);
  }
}

void ForgetDeadRotors(FlightLog* log) {
  auto& warnings = log->warnings;
  warnings.erase(std::remove_if(warnings.begin(), warnings.end(),
                                [](const std::string& warning) {
                                  return warning.find(kWrong) != std::string::npos;
                                }),
                 warnings.end());
}

void UseMocapPoses(std::vector<OdometrySample> mocap, FlightLog* log) {
  const bool has_gyro = std::any_of(log->imu.begin(), log->imu.end(),
                                    [](const ImuSample& s) { return s.gyro_I.has_value(); });
  if (!has_gyro) {
    // Both streams come from the same rows where they share a stamp: one pass pairs them.
    std::vector<ImuSample> merged;
    size_t i = 0;
    for (const OdometrySample& odometry : log->odometry) {
      while (i < log->imu.size() && log->imu[i].stamp < odometry.stamp)
        merged.push_back(log->imu[i++]);
      ImuSample sample;
      sample.stamp = odometry.stamp;
      if (i < log->imu.size() && log->imu[i].stamp == odometry.stamp) sample = log->imu[i++];
      sample.gyro_I = odometry.w_WS_S;
      if (sample.gyro_I || sample.specific_force_I) merged.push_back(sample);
    }
    merged.insert(merged.end(), log->imu.begin() + static_cast<long>(i), log->imu.end());
    log->imu = std::move(merged);
  }
  log->odometry = std::move(mocap);
}

}  // namespace odmc
