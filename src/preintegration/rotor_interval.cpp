#include "odmc/preintegration/rotor_interval.h"

#include <algorithm>

namespace odmc {
namespace {

RotorVector Interpolate(const RotorSample& a, const RotorSample& b, Stamp stamp) {
  if (b.stamp == a.stamp) return a.speed;
  const double x = static_cast<double>(stamp - a.stamp) / static_cast<double>(b.stamp - a.stamp);
  return (1.0 - x) * a.speed + x * b.speed;
}

}  // namespace

std::optional<RotorInterval> ReduceRotors(const Ring<RotorSample>& samples, Stamp from, Stamp to,
                                          double max_hole_s) {
  const auto later = [](Stamp stamp, const RotorSample& s) { return stamp < s.stamp; };
  // Last sample at or before `from`, first at or after `to`.
  auto first = std::upper_bound(samples.begin(), samples.end(), from, later);
  if (first == samples.begin()) return std::nullopt;
  --first;
  auto last = first;
  while (last != samples.end() && last->stamp < to) ++last;
  if (last == samples.end()) return std::nullopt;

  const int n = static_cast<int>(first->speed.size());
  RotorVector sum = RotorVector::Zero(n), sum_squared = RotorVector::Zero(n);
  RotorVector begin_speed, speed;
  int inside = 0;
  RotorVector model_sigma = RotorVector::Zero(n);
  for (auto it = first; it != last; ++it) {
    const auto next = it + 1;
    if (ToSeconds(next->stamp - it->stamp) > max_hole_s) return std::nullopt;
    const Stamp a = std::max(it->stamp, from), b = std::min(next->stamp, to);
    const RotorVector at_a = Interpolate(*it, *next, a);
    speed = Interpolate(*it, *next, b);
    if (it == first) begin_speed = at_a;
    const double half = 0.5 * ToSeconds(b - a);
    sum += half * (at_a + speed);
    sum_squared += half * (at_a.array().square() + speed.array().square()).matrix();
    if (it->model_sigma.size() == n) model_sigma = model_sigma.cwiseMax(it->model_sigma);
    ++inside;
  }
  if (inside == 0) return std::nullopt;
  const double dt = ToSeconds(to - from);
  RotorInterval interval;
  interval.num_samples = inside;
  interval.model_sigma = model_sigma;
  interval.mean.speed = sum / dt;
  interval.mean.speed_squared = sum_squared / dt;
  interval.mean.acceleration = (speed - begin_speed) / dt;
  interval.mean.speed_squared_rate =
      (speed.array().square() - begin_speed.array().square()).matrix() / dt;
  interval.start = interval.mean;
  interval.start.speed = begin_speed;
  interval.start.speed_squared = begin_speed.array().square().matrix();
  return interval;
}

}  // namespace odmc
