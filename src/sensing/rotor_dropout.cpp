#include "odmc/sensing/rotor_dropout.h"

#include <algorithm>
#include <cmath>

namespace odmc {
namespace {

// With shorted windings a rotor's speed falls exponentially; the quickest brake on record (3-inch
// propeller, damped light) takes 16 ms for a factor of e. Half of that, and another factor of two
// for coarse readings, is beyond any motor.
constexpr double kBrake_s = 0.008;
constexpr double kCoarse = 0.5;
constexpr double kNothing = 0.1;  // of the speed before: (almost) nothing
// Back from nothing: by a step that no motor takes. The quickest on record reach the speed of hover
// within 60 ms; a quarter of that is beyond any. A large share at once counts at any rate.
constexpr double kSpoolUp_s = 0.015;
constexpr double kLeastStep = 0.15, kLargeStep = 0.4;  // of the speed before
constexpr double kTurning_rad_s = 50.0;
constexpr Stamp kNeighbours = 50'000'000;   // [ns]: farther apart, a rotor can stop between
constexpr Stamp kLongest = 10'000'000'000;  // [ns]: no sensor comes back after that
constexpr int kSpoolingUp = 2;              // readings between nothing and as before
constexpr double kDeadShare = 0.3;  // of the stream, in which one rotor is gone and others are not

/// A rotor that cannot have slowed down from `a` to `b` in `step`.
bool Falls(double a, double b, Stamp step) {
  return a >= kTurning_rad_s && b < kNothing * a &&
         b < kCoarse * a * std::exp(-ToSeconds(step) / kBrake_s);
}

/// Rotors that `b` and `c` show stopped though they turned in `a` and, before it, in `h`.
unsigned Fallen(const RotorSample& h, const RotorSample& a, const RotorSample& b,
                const RotorSample& c) {
  const Eigen::Index n = a.speed.size();
  if (h.speed.size() != n || b.speed.size() != n || c.speed.size() != n) return 0;
  if (b.stamp - a.stamp > kNeighbours) return 0;
  unsigned fallen = 0;
  for (Eigen::Index j = 0; j < n; ++j) {
    if (h.speed[j] >= kCoarse * a.speed[j] && Falls(a.speed[j], b.speed[j], b.stamp - a.stamp) &&
        Falls(a.speed[j], c.speed[j], c.stamp - a.stamp)) {
      fallen |= 1U << j;
    }
  }
  return fallen;
}

/// Least speed over the speed before, of the rotors that fell out.
double LeastShare(const RotorSample& before, const RotorSample& now, unsigned rotors) {
  double least = 1.0;
  for (Eigen::Index j = 0; j < before.speed.size(); ++j) {
    if ((rotors >> j & 1U) != 0U) least = std::min(least, now.speed[j] / before.speed[j]);
  }
  return least;
}

}  // namespace

bool RotorDropoutWatch::Begins(const Ring<RotorSample>& stream) {
  const size_t n = stream.size();
  if (n < 4) return false;
  const RotorSample &b = stream[n - 2], &c = stream[n - 1];
  const unsigned rotors = Fallen(stream[n - 4], stream[n - 3], b, c);
  if (rotors == 0) return false;
  before_ = stream[n - 3];
  between_ = 0;
  dropout_ = RotorDropout{b.stamp, c.stamp, 2, rotors};
  return true;
}

std::optional<RotorDropout> RotorDropoutWatch::Continue(Ring<RotorSample>* stream) {
  const RotorSample& now = stream->back();
  const double share = LeastShare(before_, now, dropout_->rotors);
  const double step_s = ToSeconds(now.stamp - dropout_->last);
  const bool back = share >= std::clamp(step_s / kSpoolUp_s, kLeastStep, kLargeStep);
  between_ = back || share < kNothing ? 0 : between_ + 1;
  if (back || between_ >= kSpoolingUp || now.stamp - dropout_->first > kLongest) {
    const RotorDropout ended = *dropout_;
    dropout_.reset();
    if (back) return ended;
    return std::nullopt;
  }
  dropout_->last = now.stamp;  // it is nothing, or a single one between
  ++dropout_->readings;
  stream->pop_back();
  return std::nullopt;
}

std::optional<RotorDropout> RotorDropoutWatch::Sift(Ring<RotorSample>* stream) {
  if (stream->empty()) return std::nullopt;
  if (dropout_) return Continue(stream);
  if (Begins(*stream)) {
    stream->pop_back();
    stream->pop_back();
  }
  return std::nullopt;
}

std::vector<RotorDropout> TakeDropouts(std::vector<RotorSample>* stream) {
  std::vector<RotorDropout> found;
  RotorDropoutWatch watch;
  Ring<RotorSample> recent;
  std::vector<long> gone(kMaxRotors, 0);
  for (const RotorSample& sample : *stream) {
    recent.push_back(sample);
    while (recent.size() > 4) recent.pop_front();
    const std::optional<RotorDropout> ended = watch.Sift(&recent);
    if (!ended) continue;
    found.push_back(*ended);
    for (int j = 0; j < kMaxRotors; ++j) {
      if ((ended->rotors >> j & 1U) != 0U) gone[static_cast<size_t>(j)] += ended->readings;
    }
  }
  const unsigned every = stream->empty() ? 0 : (1U << stream->front().speed.size()) - 1U;
  const auto is_dead = [&](const RotorDropout& dropout) {
    if (dropout.rotors == every) return false;
    for (int j = 0; j < kMaxRotors; ++j) {
      const auto share =
          static_cast<double>(gone[static_cast<size_t>(j)]) / static_cast<double>(stream->size());
      if ((dropout.rotors >> j & 1U) != 0U && share > kDeadShare) return true;
    }
    return false;
  };
  found.erase(std::remove_if(found.begin(), found.end(), is_dead), found.end());
  size_t next = 0;
  const auto is_missing = [&](const RotorSample& sample) {
    while (next < found.size() && found[next].last < sample.stamp) ++next;
    return next < found.size() && sample.stamp >= found[next].first;
  };
  stream->erase(std::remove_if(stream->begin(), stream->end(), is_missing), stream->end());
  return found;
}

}  // namespace odmc
