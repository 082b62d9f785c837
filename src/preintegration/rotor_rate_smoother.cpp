#include "odmc/preintegration/rotor_rate_smoother.h"

#include <cmath>

#include "odmc/math/hann.h"

namespace odmc {

void RotorRateSmoother::Add(std::int64_t id, double time_s, double dt, const RotorState& mean) {
  intervals_.push_back({id, time_s, dt, mean.acceleration, mean.speed_squared_rate});
  // Half a window before those that may still change.
  while (time_s - intervals_.front().time_s > 1.1 * kRotorRatesWindow_s) intervals_.pop_front();
}

RotorRateSmoother::Rates RotorRateSmoother::About(int middle) const {
  const auto time = [this](int i) { return intervals_[i].time_s; };
  const int reach = HannReach(middle, static_cast<int>(intervals_.size()), kRotorRatesWindow_s,
                              time, [](int) { return true; });
  Rates rates;
  rates.acceleration.setZero(intervals_[middle].acceleration.size());
  rates.speed_squared_rate = rates.acceleration;
  double sum = 0.0, before = 0.0, square = 0.0;
  for (int i = middle - reach; i <= middle + reach; ++i) {
    const Interval& interval = intervals_[i];
    const double w = Hann((time(i) - time(middle)) / kRotorRatesWindow_s);
    sum += w;
    rates.acceleration += w * interval.acceleration;
    rates.speed_squared_rate += w * interval.speed_squared_rate;
    // The speed at a boundary enters the intervals on both sides of it.
    square += std::pow(before - w / interval.dt, 2);
    before = w / interval.dt;
  }
  square += before * before;
  rates.acceleration /= sum;
  rates.speed_squared_rate /= sum;
  rates.noise = std::sqrt(square) / sum;
  return rates;
}

}  // namespace odmc
