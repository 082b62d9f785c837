#include "odmc/preintegration/rotor_rate_smoother.h"

#include <cmath>

#include "odmc/math/hann.h"

namespace odmc {

void RotorRateSmoother::Add(std::int64_t id, double time_s, double dt, const RotorState& mean,
                            int num_samples) {
  intervals_.push_back({id, time_s, dt, mean, num_samples});
  // Half a window before those that may still change.
  while (time_s - intervals_.front().time_s > 1.1 * kRotorRatesWindow_s) intervals_.pop_front();
}

RotorRateSmoother::Rates RotorRateSmoother::About(int middle) const {
  const auto time = [this](int i) { return intervals_[i].time_s; };
  const int reach = HannReach(middle, static_cast<int>(intervals_.size()), kRotorRatesWindow_s,
                              time, [](int) { return true; });
  const RotorState& own = intervals_[middle].mean;
  if (reach == 0) {
    return {own.acceleration, own.speed_squared_rate, std::sqrt(2.0) / intervals_[middle].dt};
  }
  const auto boundary = [&](int i) {  // after interval i, from the middle, in windows
    return (intervals_[i].time_s + 0.5 * intervals_[i].dt - time(middle)) / kRotorRatesWindow_s;
  };
  double moment[3] = {0.0, 0.0, 0.0};
  for (int i = middle - reach; i < middle + reach; ++i) {
    const double t = boundary(i), w = Hann(t);
    for (int k = 0; k < 3; ++k) moment[k] += w * std::pow(t * t, k);
  }
  // Weights with no second moment, of which two need at least four differences.
  const double scale = moment[0] * moment[2] - moment[1] * moment[1];
  const bool keeps_curves = 2 * reach >= 4 && scale > 1e-9 * moment[0] * moment[0];
  const double level = keeps_curves ? moment[2] / scale : 1.0 / moment[0];
  const double curve = keeps_curves ? -moment[1] / scale : 0.0;
  Rates rates;
  rates.acceleration.setZero(own.speed.size());
  rates.speed_squared_rate = rates.acceleration;
  double before = 0.0, square = 0.0;
  for (int i = middle - reach; i < middle + reach; ++i) {
    const Interval& a = intervals_[i];
    const Interval& b = intervals_[i + 1];
    const double t = boundary(i);
    const double per_second = Hann(t) * (level + curve * t * t) / (b.time_s - a.time_s);
    rates.acceleration += per_second * (b.mean.speed - a.mean.speed);
    rates.speed_squared_rate += per_second * (b.mean.speed_squared - a.mean.speed_squared);
    // An interval's mean enters the differences on both sides of it.
    square += std::pow(before - per_second, 2) / a.num_samples;
    before = per_second;
  }
  square += before * before / intervals_[middle + reach].num_samples;
  rates.noise = std::sqrt(square);
  return rates;
}

}  // namespace odmc
