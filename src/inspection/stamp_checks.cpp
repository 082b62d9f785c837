#include "odmc/inspection/stamp_checks.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "odmc/math/line.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

constexpr double kLongestHole_s = 0.2;  // longer ones part a stream
constexpr double kTooClose = 0.5;       // of the period
// Clocks of sensors and loggers leave no step below half a period (63 recordings of nine vehicles
// from elsewhere: none), stamps of arrival a tenth of them or nearly all.
constexpr double kMostClose = 0.05;
constexpr double kHalfWindow_s = 0.25;
constexpr size_t kFewest = 50, kLeastHalfWindow = 10;

/// Mean step of a stream, holes left out [s], and the share of steps that are much shorter.
struct Steps {
  double period_s = 0.0, close = 0.0;
};

Steps StepsOf(const std::vector<double>& t_s) {
  double sum = 0.0;
  std::vector<double> steps;
  for (size_t i = 1; i < t_s.size(); ++i) {
    const double step_s = t_s[i] - t_s[i - 1];
    if (step_s > kLongestHole_s) continue;
    steps.push_back(step_s);
    sum += step_s;
  }
  if (steps.empty()) return {};
  const auto n = static_cast<double>(steps.size());
  const double least = kTooClose * sum / n;
  const auto close = std::count_if(steps.begin(), steps.end(), [&](double s) { return s < least; });
  return {sum / n, static_cast<double>(close) / n};
}

/// Lines through `half` neighbours to both sides, within [begin, end).
void EvenOut(size_t begin, size_t end, size_t half, const std::vector<double>& t_s,
             std::vector<double>* even) {
  for (size_t i = begin; i < end; ++i) {
    const size_t from = std::max(begin + half, i) - half, to = std::min(end, i + half + 1);
    const StraightLine line = LineThrough(t_s.data() + from, to - from);
    (*even)[i] = line.At(static_cast<double>(i - from));
  }
}

std::vector<double> Evened(const std::vector<double>& t_s, double period_s) {
  std::vector<double> even = t_s;
  const size_t half =
      std::max(kLeastHalfWindow, static_cast<size_t>(std::lround(kHalfWindow_s / period_s)));
  size_t begin = 0;
  for (size_t i = 1; i <= t_s.size(); ++i) {
    if (i < t_s.size() && t_s[i] - t_s[i - 1] <= kLongestHole_s) continue;
    if (i - begin > kLeastHalfWindow) EvenOut(begin, i, half, t_s, &even);
    begin = i;
  }
  return even;
}

template <typename Sample>
void Check(const std::string& check, const std::string& called, std::vector<Sample>* stream,
           std::vector<Finding>* findings) {
  if (stream->size() < kFewest) return;
  const Stamp zero = stream->front().stamp;
  std::vector<double> t_s;
  for (const Sample& sample : *stream) t_s.push_back(ToSeconds(sample.stamp - zero));
  const Steps steps = StepsOf(t_s);
  if (steps.close < kMostClose) return;
  const std::vector<double> even = Evened(t_s, steps.period_s);
  double square = 0.0;
  Stamp before = zero - FromSeconds(1.0);
  for (size_t i = 0; i < stream->size(); ++i) {
    square += (even[i] - t_s[i]) * (even[i] - t_s[i]);
    (*stream)[i].stamp = std::max(before + 1, zero + FromSeconds(even[i]));
    before = (*stream)[i].stamp;
  }
  const std::string what = Format(
      "the stamps of %s jitter by %.1f ms (RMS; %.0f %% follow the one before within "
      "half a period): times of arrival; they were evened out",
      called.c_str(), 1e3 * std::sqrt(square / static_cast<double>(stream->size())),
      100.0 * steps.close);
  findings->push_back({check, Trust::kGood, what, "stamp samples when they are measured"});
}

}  // namespace

std::vector<Finding> EvenOutStamps(FlightLog* log) {
  std::vector<Finding> findings;
  Check("pose_jitter", "the poses", &log->odometry, &findings);
  Check("rotor_jitter", "the rotor speeds", &log->rotors, &findings);
  Check("imu_jitter", "the IMU", &log->imu, &findings);
  return findings;
}

}  // namespace odmc
