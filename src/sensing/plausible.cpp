#include "odmc/sensing/plausible.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "odmc/math/so3.h"
#include "odmc/sensing/flight_checks.h"
#include "odmc/sensing/rotor_dropout.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

using Eigen::Vector3d;
using OptionalVector = std::optional<Vector3d>;

constexpr Stamp kNeighbours = 50'000'000;  // [ns]: farther apart, a rotor can really do it
constexpr double kRateOffTurn_rad_s = 15.0;
// What a rotor's speed cannot do from one sample to the next and back.
constexpr double kTimesFaster = 2.0, kTimesSlower = 0.4, kLeast_rad_s = 10.0;
constexpr double kRateLeap_rad_s = 5.0;
constexpr double kForceLeap_m_s2 = 100.0;

bool IsWithin(const Vector3d& v, double most) {  // false for NaN
  return v.cwiseAbs().maxCoeff() <= most && v.allFinite();
}
bool IsWithin(const OptionalVector& v, double most) { return !v || IsWithin(*v, most); }

double Between(double a, double b, double share) { return a + share * (b - a); }

/// A rotor's speed that leaps away from those between `low` and `high`.
bool LeapsFrom(double low, double high, double speed) {
  return speed > kTimesFaster * high + kLeast_rad_s || speed < kTimesSlower * low - kLeast_rad_s;
}

bool LeapsFrom(const OptionalVector& a, const OptionalVector& b, double leap) {
  return a && b && (*b - *a).cwiseAbs().maxCoeff() > leap;
}

/// Mends `b` between its neighbours `a` and `c`.
bool MendVector(const OptionalVector& a, const OptionalVector& c, double share, double leap,
                OptionalVector* b) {
  if (!a || !*b || !c) return false;
  bool mended = false;
  for (int i = 0; i < 3; ++i) {
    const auto [low, high] = std::minmax((*a)[i], (*c)[i]);
    if ((**b)[i] >= low - leap && (**b)[i] <= high + leap) continue;
    (**b)[i] = Between((*a)[i], (*c)[i], share);
    mended = true;
  }
  return mended;
}

/// Where a sample lies between its neighbours, as a share of their distance; below 0 if these are
/// too far away.
template <typename Sample>
double Share(const Sample& before, const Sample& sample, const Sample& after) {
  const Stamp span = after.stamp - before.stamp;
  if (span > kNeighbours || span <= 0) return -1.0;
  return static_cast<double>(sample.stamp - before.stamp) / static_cast<double>(span);
}

/// Mends `b` between its neighbours `a` and `c`. @returns true if there was something to mend
bool Mend(const RotorSample& a, const RotorSample& c, RotorSample* b) {
  const double share = Share(a, *b, c);
  if (share < 0.0 || a.speed.size() != b->speed.size() || c.speed.size() != b->speed.size()) {
    return false;
  }
  bool mended = false;
  for (Eigen::Index j = 0; j < b->speed.size(); ++j) {
    const auto [low, high] = std::minmax(a.speed[j], c.speed[j]);
    if (!LeapsFrom(low, high, b->speed[j])) continue;
    b->speed[j] = Between(a.speed[j], c.speed[j], share);
    mended = true;
  }
  return mended;
}

bool Mend(const ImuSample& a, const ImuSample& c, ImuSample* b) {
  const double share = Share(a, *b, c);
  if (share < 0.0) return false;
  const bool gyro = MendVector(a.gyro_I, c.gyro_I, share, kRateLeap_rad_s, &b->gyro_I);
  const bool force = MendVector(a.specific_force_I, c.specific_force_I, share, kForceLeap_m_s2,
                                &b->specific_force_I);
  return gyro || force;
}

template <typename Sample>
bool MendLastButOne(Ring<Sample>* queue) {
  const size_t n = queue->size();
  return n >= 3 && Mend((*queue)[n - 3], (*queue)[n - 1], &(*queue)[n - 2]);
}

/// What was found in a recording.
struct Finds {
  long beyond = 0, glitches = 0;
  std::optional<Stamp> first_beyond, first_glitch;

  void AddBeyond(Stamp stamp) {
    ++beyond;
    if (!first_beyond || stamp < *first_beyond) first_beyond = stamp;
  }
  void AddGlitch(Stamp stamp) {
    ++glitches;
    if (!first_glitch || stamp < *first_glitch) first_glitch = stamp;
  }
};

template <typename Sample>
void MendStream(std::vector<Sample>* samples, Finds* finds) {
  size_t kept = 0;
  for (size_t i = 0; i < samples->size(); ++i) {
    if (!IsPlausible((*samples)[i])) {
      finds->AddBeyond((*samples)[i].stamp);
      continue;
    }
    if (kept != i) (*samples)[kept] = std::move((*samples)[i]);
    ++kept;
    if (kept >= 3 && Mend((*samples)[kept - 3], (*samples)[kept - 1], &(*samples)[kept - 2])) {
      finds->AddGlitch((*samples)[kept - 2].stamp);
    }
  }
  samples->resize(kept);
}

void MendStream(std::vector<OdometrySample>* samples, Finds* finds) {
  size_t kept = 0;
  for (size_t i = 0; i < samples->size(); ++i) {
    OdometrySample& sample = (*samples)[i];
    if (!IsPlausible(sample)) {
      finds->AddBeyond(sample.stamp);
    } else if (kept > 0 && ContradictsTurn((*samples)[kept - 1], sample)) {
      finds->AddGlitch(sample.stamp);
    } else {
      if (kept != i) (*samples)[kept] = sample;
      ++kept;
    }
  }
  samples->resize(kept);
}

std::string Found(const std::string& stream, long count, const std::string& what, Stamp first,
                  Stamp zero) {
  return std::to_string(count) + (count == 1 ? " sample" : " samples") + " of " + stream + " " +
         what + (count == 1 ? ", " : ", the first ") + Format("%.3f", ToSeconds(first - zero)) +
         " s after the first pose";
}

template <typename Sample>
void MendNamed(const std::string& stream, Stamp zero, std::vector<Sample>* samples,
               FlightLog* log) {
  Finds finds;
  MendStream(samples, &finds);
  log->dropped += finds.beyond;
  if (finds.beyond > 0) {
    log->warnings.push_back(
        Found(stream, finds.beyond, "beyond what a sensor reads", *finds.first_beyond, zero) +
        ": dropped");
  }
  if (finds.glitches > 0) {
    log->warnings.push_back(Found(stream, finds.glitches, "leaping away from both neighbours",
                                  *finds.first_glitch, zero) +
                            ": not used");
  }
}

// Single readings that no sensor has are glitches; so many of them are another unit.
constexpr double kOtherUnit = 0.02;

/// Leaves rates out where too many are beyond what a sensor reads: by their size they are in deg/s.
template <typename Sample, typename Member>
void DropRatesOfOtherUnit(const std::string& check, Member rates, std::vector<Sample>* samples,
                          FlightLog* log) {
  long beyond = 0, all = 0;
  for (const Sample& sample : *samples) {
    if (!(sample.*rates) || !(sample.*rates)->allFinite()) continue;
    ++all;
    if ((sample.*rates)->cwiseAbs().maxCoeff() > kMostRate_rad_s) ++beyond;
  }
  const double share = all > 0 ? static_cast<double>(beyond) / static_cast<double>(all) : 0.0;
  if (share < kOtherUnit) return;
  for (Sample& sample : *samples) (sample.*rates).reset();
  const std::string text = Format(
      ": %.0f %% are beyond what a sensor reads (%.0f rad/s): in degrees (deg/s)? They are "
      "not used",
      100.0 * share, kMostRate_rad_s);
  log->warnings.push_back(check + text);
}

template <typename Sample>
bool HasNeighbour(const Ring<Sample>& queue) {
  const size_t n = queue.size();
  return n >= 2 && queue[n - 1].stamp - queue[n - 2].stamp <= kNeighbours;
}

/// "rotor1, rotor3" of the bits that are set in `rotors`.
std::string RotorNames(unsigned rotors) {
  std::string names;
  for (int j = 0; j < kMaxRotors; ++j) {
    if ((rotors >> j & 1U) != 0U)
      names += (names.empty() ? "rotor" : ", rotor") + std::to_string(j + 1);
  }
  return names;
}

/// One sentence for all dropouts.
std::string Sentence(const std::vector<RotorDropout>& dropouts, Stamp zero) {
  long readings = 0;
  unsigned rotors = 0;
  for (const RotorDropout& dropout : dropouts) {
    readings += dropout.readings;
    rotors |= dropout.rotors;
  }
  const std::string first =
      Format("%.3f to %.3f s after the first pose", ToSeconds(dropouts.front().first - zero),
             ToSeconds(dropouts.front().last - zero));
  const std::string times = dropouts.size() == 1
                                ? "once, from "
                                : std::to_string(dropouts.size()) + " times, the first from ";
  return "rotor speeds fell out (" + RotorNames(rotors) +
         " read nothing and came back, quicker than any rotor stops) " + times + first + ": " +
         std::to_string(readings) + " readings are missing, not zero";
}

void MendDropouts(Stamp zero, FlightLog* log) {
  const std::vector<RotorDropout> dropouts = TakeDropouts(&log->rotors);
  if (dropouts.empty()) return;
  // What was said of dead rotors counted these readings.
  ForgetDeadRotors(log);
  WarnOfDeadRotors(log->file, log);
  log->warnings.push_back(Sentence(dropouts, zero));
}

}  // namespace

bool IsPlausible(const OdometrySample& s) {
  return IsWithin(s.p_WS, kMostDistance_m) && s.q_WS.coeffs().allFinite() &&
         std::abs(s.q_WS.norm() - 1.0) < 0.05 && IsWithin(s.v_WS, kMostSpeed_m_s) &&
         IsWithin(s.w_WS_S, kMostRate_rad_s);
}

bool IsPlausible(const ImuSample& s) {
  return IsWithin(s.gyro_I, kMostRate_rad_s) &&
         IsWithin(s.specific_force_I, kMostSpecificForce_m_s2);
}

bool IsPlausible(const RotorSample& s) {
  return s.speed.allFinite() && (s.speed.array() >= 0.0).all() &&
         (s.speed.array() <= kMostRotorSpeed_rad_s).all();
}

bool ContradictsTurn(const OdometrySample& before, const OdometrySample& sample) {
  const Stamp step = sample.stamp - before.stamp;
  if (step <= 0 || step > kNeighbours) return false;
  if (!LeapsFrom(before.w_WS_S, sample.w_WS_S, kRateLeap_rad_s)) return false;
  const Vector3d turn = Log(before.q_WS.conjugate() * sample.q_WS) / ToSeconds(step);
  return (*sample.w_WS_S - turn).norm() > kRateOffTurn_rad_s;
}

bool MayBeGlitch(const Ring<RotorSample>& queue) {
  if (!HasNeighbour(queue)) return false;
  const RotorVector &a = queue[queue.size() - 2].speed, &b = queue.back().speed;
  if (a.size() != b.size()) return false;
  for (Eigen::Index j = 0; j < b.size(); ++j) {
    if (LeapsFrom(a[j], a[j], b[j])) return true;
  }
  return false;
}

bool MayBeGlitch(const Ring<ImuSample>& queue) {
  if (!HasNeighbour(queue)) return false;
  const ImuSample &a = queue[queue.size() - 2], &b = queue.back();
  return LeapsFrom(a.gyro_I, b.gyro_I, kRateLeap_rad_s) ||
         LeapsFrom(a.specific_force_I, b.specific_force_I, kForceLeap_m_s2);
}

bool MendGlitch(Ring<RotorSample>* queue) { return MendLastButOne(queue); }
bool MendGlitch(Ring<ImuSample>* queue) { return MendLastButOne(queue); }

void MendFlight(FlightLog* log) {
  if (log->odometry.empty()) return;
  const Stamp zero = log->odometry.front().stamp;
  DropRatesOfOtherUnit("body rates", &OdometrySample::w_WS_S, &log->odometry, log);
  DropRatesOfOtherUnit("gyro", &ImuSample::gyro_I, &log->imu, log);
  auto& imu = log->imu;
  imu.erase(std::remove_if(imu.begin(), imu.end(),
                           [](const ImuSample& s) { return !s.gyro_I && !s.specific_force_I; }),
            imu.end());
  MendNamed("odometry", zero, &log->odometry, log);
  MendNamed("the IMU", zero, &log->imu, log);
  MendNamed("rotor speeds", zero, &log->rotors, log);
  if (!log->rotor_rms_only) MendDropouts(zero, log);
}

}  // namespace odmc
