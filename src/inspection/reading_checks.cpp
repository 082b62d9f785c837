#include "odmc/inspection/reading_checks.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <utility>

#include "odmc/inspection/motion_signals.h"
#include "odmc/math/statistics.h"
#include "odmc/sensing/flight_checks.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

// ---- Clocks
// --------------------------------------------------------------------------------------

/// Streams that have no time in common were stamped by different clocks.
std::optional<Finding> CheckClocks(const FlightLog& log) {
  if (log.odometry.empty() || log.rotors.empty()) return std::nullopt;
  const double from_s = FlightSeconds(log.rotors.front().stamp, log);
  const double to_s = FlightSeconds(log.rotors.back().stamp, log);
  const double end_s = FlightSeconds(log.odometry.back().stamp, log);
  if (to_s > 0.0 && from_s < end_s) return std::nullopt;
  return Finding{"clocks", Trust::kBad,
                 "rotor speeds and poses have no time in common: poses last " +
                     Format("%.4g", end_s) + " s, rotor speeds are stamped from " +
                     Format("%.6g", from_s) + " to " + Format("%.6g", to_s) +
                     " s after the first pose: by another clock",
                 "stamp both by one clock"};
}

// ---- Holes
// ---------------------------------------------------------------------------------------

// Longer than anything that lines between samples can bridge, and than packets lost in a row.
constexpr double kHole_s = 0.2;
constexpr double kUsualSteps = 5.0;  // of a slow stream

struct Holes {
  long count = 0;
  double longest_s = 0.0, at_s = 0.0, missing_s = 0.0;
};

template <typename Sample>
Holes HolesOf(const std::vector<Sample>& samples, const FlightLog& log) {
  std::vector<double> steps_s;
  for (size_t i = 1; i < samples.size(); ++i) {
    steps_s.push_back(ToSeconds(samples[i].stamp - samples[i - 1].stamp));
  }
  const double least_s = std::max(kHole_s, kUsualSteps * Median(steps_s));
  Holes holes;
  for (size_t i = 0; i < steps_s.size(); ++i) {
    if (steps_s[i] <= least_s) continue;
    ++holes.count;
    holes.missing_s += steps_s[i];
    if (steps_s[i] <= holes.longest_s) continue;
    holes.longest_s = steps_s[i];
    holes.at_s = FlightSeconds(samples[i].stamp, log);
  }
  return holes;
}

void CheckHoles(const FlightLog& log, std::vector<Finding>* findings) {
  if (log.odometry.empty()) return;
  std::vector<std::string> streams;
  double from_s = 0.0, to_s = 0.0, longest_s = 0.0;
  const auto add = [&](const std::string& stream, const Holes& holes) {
    if (holes.count == 0) return;
    streams.push_back(
        stream + " are missing " + std::to_string(holes.count) +
        (holes.count == 1 ? " time, for " : " times, the longest for ") +
        Format("%.2g s at %.4g s (%.3g s in all)", holes.longest_s, holes.at_s, holes.missing_s));
    if (holes.longest_s <= longest_s) return;
    longest_s = holes.longest_s;
    from_s = holes.at_s;
    to_s = holes.at_s + holes.longest_s;
  };
  add("poses", HolesOf(log.odometry, log));
  add("rotor speeds", HolesOf(log.rotors, log));
  add("IMU samples", HolesOf(log.imu, log));
  if (streams.empty()) return;
  findings->push_back({"holes", Trust::kGood, Listed(streams),
                       "nothing is learned there: look at logger and radio",
                       std::make_pair(from_s, to_s)});
}

// ---- Poses
// ---------------------------------------------------------------------------------------

// A position that follows the one before: what is off is the error of the source, an acceleration
// of 20 g between two samples, and a stamp that is off by a step. Errors have tails that fall like
// an exponential (corrections of filters) or faster: every tenth of the probability adds no more
// than the one from a tenth to a hundredth. What one sample in 10^10 has by that is an event.
constexpr double kMostAcceleration_m_s2 = 200.0;
constexpr double kDecades = 8.0;  // from 10^-2 on
constexpr double kLongestStep_s = 0.1;
constexpr double kLeastJump_m = 0.02;
constexpr double kFastest_m_s = 20.0;

std::optional<Finding> CheckJumps(const FlightLog& log) {
  const auto& poses = log.odometry;
  if (poses.size() < 200) return std::nullopt;
  std::vector<double> off_m, times_s;
  const OdometrySample* a = &poses[0];
  const OdometrySample* b = nullptr;
  for (size_t i = 1; i < poses.size(); ++i) {
    if (poses[i].p_WS == (b != nullptr ? b : a)->p_WS) continue;  // the same measurement again
    if (b == nullptr) {
      b = &poses[i];
      continue;
    }
    const double before_s = ToSeconds(b->stamp - a->stamp);
    const double step_s = ToSeconds(poses[i].stamp - b->stamp);
    if (before_s < kLongestStep_s && step_s < kLongestStep_s) {
      const Eigen::Vector3d on = b->p_WS + (b->p_WS - a->p_WS) * (step_s / before_s);
      const double span_s = step_s * (step_s + before_s);
      const double a_step_m = (b->p_WS - a->p_WS).norm() * std::max(1.0, step_s / before_s);
      off_m.push_back((poses[i].p_WS - on).norm() - 0.5 * kMostAcceleration_m_s2 * span_s -
                      std::min(a_step_m, kFastest_m_s * step_s));
      times_s.push_back(FlightSeconds(poses[i].stamp, log));
    }
    a = b;
    b = &poses[i];
  }
  if (off_m.empty()) return std::nullopt;
  const double rare_m = Quantile(off_m, 0.99), seldom_m = Quantile(off_m, 0.9);
  const double least_m = std::max(kLeastJump_m, rare_m + kDecades * (rare_m - seldom_m));
  long count = 0;
  double first_s = 0.0, largest_m = 0.0, last_s = -1.0;
  for (size_t i = 0; i < off_m.size(); ++i) {
    if (off_m[i] < least_m) continue;
    largest_m = std::max(largest_m, off_m[i]);
    if (times_s[i] - last_s < kLongestStep_s && count > 0) continue;  // of the same jump
    if (count++ == 0) first_s = times_s[i];
    last_s = times_s[i];
  }
  if (count == 0) return std::nullopt;
  return Finding{"pose_jump", Trust::kGood,
                 "the position jumps " +
                     std::string(count == 1 ? "once" : std::to_string(count) + " times") +
                     ", by up to " + Format("%.2g", largest_m) + " m (the first at " +
                     Format("%.4g", first_s) + " s), which no vehicle can",
                 "markers exchanged, or a filter that was corrected: look at the pose's source",
                 std::make_pair(first_s, first_s)};
}

/// Mean sum of squared speeds of a span; 0 without readings.
double SquaresIn(Stamp from, Stamp to, const FlightLog& log) {
  const auto before = [](const RotorSample& s, Stamp t) { return s.stamp < t; };
  auto it = std::lower_bound(log.rotors.begin(), log.rotors.end(), from, before);
  double sum = 0.0, n = 0.0;
  for (; it != log.rotors.end() && it->stamp <= to; ++it) {
    sum += it->speed.squaredNorm();
    n += 1.0;
  }
  return n > 0.0 ? sum / n : 0.0;
}

/// Poses that stay to the last digit while the rotors turn as in flight: a source that froze.
std::optional<Finding> CheckFrozen(const FlightLog& log) {
  constexpr double kFrozen_s = 0.2;
  constexpr double kCarried = 0.5;  // of the thrust that the rotors give half of the time or more
  std::vector<double> squares;
  for (const RotorSample& s : log.rotors) squares.push_back(s.speed.squaredNorm());
  const double usual = Quantile(squares, 0.75);
  const auto& poses = log.odometry;
  for (size_t i = 1, first = 0; i <= poses.size() && !poses.empty(); ++i) {
    if (i < poses.size() && IsSamePose(poses[i], poses[first])) continue;
    const Stamp from = poses[first].stamp, to = poses[i - 1].stamp;
    first = i;
    const double long_s = ToSeconds(to - from);
    if (long_s <= kFrozen_s || !(SquaresIn(from, to, log) > kCarried * usual)) continue;
    const double zero_s = FlightSeconds(from, log);
    return Finding{
        "frozen_pose", Trust::kGood,
        "the pose stays to the last digit for " + Format("%.3g", long_s) + " s in flight",
        "its source stalls: look there, or cut the flight before (--end " + Format("%.3g", zero_s) +
            ")",
        std::make_pair(zero_s, zero_s + long_s)};
  }
  return std::nullopt;
}

// ---- Rotor speeds
// --------------------------------------------------------------------------------

constexpr long kLeastAtLimit = 20;
constexpr size_t kNeighbours = 5;   // values next to the largest
constexpr double kTimesMore = 3.0;  // than the most frequent of these
constexpr double kAccident = 1e-6;  // probability by Poisson's law
constexpr double kHarmful = 0.02;   // share of readings

/// Upper bound of the probability of `n` or more where `mean` are expected (Chernoff).
double PoissonTail(double n, double mean) {
  return n <= mean ? 1.0 : std::exp(n - mean - n * std::log(n / mean));
}

/// Share of a rotor's readings that are exactly its largest one, where that is no accident of a
/// smooth distribution; 0 otherwise.
double ShareAtLimit(const std::vector<RotorSample>& rotors, Eigen::Index j, double* limit) {
  std::map<double, long, std::greater<>> count;
  for (const RotorSample& sample : rotors) ++count[sample.speed[j]];
  if (count.size() < 4 * kNeighbours) return 0.0;
  auto it = count.begin();
  *limit = it->first;
  const long at = it->second;
  long most = 1;
  for (size_t i = 0; i < kNeighbours; ++i) most = std::max(most, (++it)->second);
  const double tail = PoissonTail(static_cast<double>(at), kTimesMore * static_cast<double>(most));
  if (at < kLeastAtLimit || tail > kAccident) return 0.0;
  return static_cast<double>(at) / static_cast<double>(rotors.size());
}

std::optional<Finding> CheckLimit(const FlightLog& log) {
  if (log.rotors.empty() || log.rotor_rms_only) return std::nullopt;
  std::string names;
  double most = 0.0, limit = 0.0;
  for (Eigen::Index j = 0; j < log.rotors.front().speed.size(); ++j) {
    double at = 0.0;
    const double share = ShareAtLimit(log.rotors, j, &at);
    if (share == 0.0) continue;
    names += (names.empty() ? "rotor" : ", rotor") + std::to_string(j + 1);
    if (share > most) limit = at;
    most = std::max(most, share);
  }
  if (names.empty()) return std::nullopt;
  return Finding{"rotor_limit", most > kHarmful ? Trust::kDoubtful : Trust::kGood,
                 "readings of " + names + " are clipped: up to " + Format("%.2g", 100.0 * most) +
                     " % of them are exactly " + Format("%.4g", limit) +
                     " rad/s, and none is above; the rotors turn faster",
                 "widen the range of the speed's sensor or message"};
}

// ---- Battery
// -------------------------------------------------------------------------------------

struct VoltageUnit {
  const char* name;
  double factor, prior;
};

constexpr VoltageUnit kVoltageUnits[] = {{"V", 1.0, 0.9},
                                         {"mV", 1e3, 0.06},
                                         {"hundredths of V (cV)", 1e2, 0.03},
                                         {"tenths of V (dV)", 10.0, 0.01}};
// Voltage over the mass to the power 0.4: 3.8 V at 35 g, 15 V at 0.8 kg, 45 V at 10 kg.
constexpr double kVoltsAtOneKilogram = 16.0, kPower = 0.4, kLogSigma = 0.6;

std::optional<Finding> CheckBattery(const FlightLog& log, const Vehicle& vehicle) {
  std::vector<double> voltages;
  for (const BatterySample& s : log.battery) voltages.push_back(s.voltage_V);
  const double median = Median(voltages);
  if (!(median > 0.0)) return std::nullopt;
  const double typical = kVoltsAtOneKilogram * std::pow(vehicle.mass_kg, kPower);
  double sum = 0.0, most = 0.0, right = 0.0;
  const VoltageUnit* best = nullptr;
  for (const VoltageUnit& unit : kVoltageUnits) {
    const double z = std::log(median / unit.factor / typical) / kLogSigma;
    const double weight = unit.prior * std::exp(-0.5 * z * z);
    if (unit.factor == 1.0) right = weight;
    sum += weight;
    if (weight <= most) continue;
    most = weight;
    best = &unit;
  }
  if (best == nullptr || !(right < 1e-4 * sum)) return std::nullopt;
  return Finding{
      "battery_unit", Trust::kGood,
      "the battery's voltage, " + Format("%.4g", median) + ", is not in V but in " + best->name +
          " (probability " + Format("%.2g", most / sum) + ")",
      "divide it by " + Format("%g", best->factor) + " (column vbat, BatteryState.voltage)"};
}

}  // namespace

std::vector<Finding> CheckReadings(const FlightLog& log, const Vehicle& vehicle) {
  std::vector<Finding> findings;
  if (const auto clocks = CheckClocks(log)) return {*clocks};
  CheckHoles(log, &findings);
  for (const auto& finding :
       {CheckJumps(log), CheckFrozen(log), CheckLimit(log), CheckBattery(log, vehicle)}) {
    if (finding) findings.push_back(*finding);
  }
  return findings;
}

}  // namespace odmc
