#include "odmc/inspection/stream_watch.h"

#include <algorithm>
#include <stdexcept>

#include "odmc/sensing/topic_clock.h"

namespace odmc {

StreamWatch::StreamWatch(const Vehicle& vehicle, const Options& options)
    : vehicle_(vehicle), options_(options) {
  if (!(options.keep_s > 0.0) || !(options.every_s > 0.0) || options.most_samples < 1) {
    throw std::invalid_argument("StreamWatch: keep_s, every_s and most_samples must be positive");
  }
}

template <typename Sample>
void StreamWatch::Push(const Sample& sample, std::deque<Sample>* stream) {
  if (!stream->empty() && sample.stamp <= stream->back().stamp) {
    if (!IsStepBack(stream->back().stamp, sample.stamp)) return;  // late: refused
    Clear();
  }
  stream->push_back(sample);
  const Stamp oldest = sample.stamp - FromSeconds(options_.keep_s);
  while (stream->front().stamp < oldest ||
         static_cast<long>(stream->size()) > options_.most_samples) {
    stream->pop_front();
  }
}

void StreamWatch::Add(const OdometrySample& sample) {
  Push(sample, &odometry_);
  if (!last_look_) last_look_ = sample.stamp;
}
void StreamWatch::Add(const ImuSample& sample) { Push(sample, &imu_); }
void StreamWatch::Add(const RotorSample& sample) { Push(sample, &rotors_); }

bool StreamWatch::IsDue() const {
  return !odometry_.empty() && last_look_ &&
         ToSeconds(odometry_.back().stamp - *last_look_) >= options_.every_s;
}

template <typename Sample>
std::vector<Sample> StreamWatch::Newest(const std::deque<Sample>& stream) const {
  if (odometry_.empty()) return {stream.begin(), stream.end()};
  const Stamp oldest = odometry_.back().stamp - FromSeconds(options_.keep_s);
  const auto first = std::lower_bound(stream.begin(), stream.end(), oldest,
                                      [](const Sample& s, Stamp t) { return s.stamp < t; });
  return {first, stream.end()};
}

FlightLog StreamWatch::TakeLook() {
  if (!odometry_.empty()) last_look_ = odometry_.back().stamp;
  FlightLog log;
  log.odometry.assign(odometry_.begin(), odometry_.end());
  log.imu = Newest(imu_);
  log.rotors = Newest(rotors_);
  return log;
}

void StreamWatch::Clear() {
  odometry_.clear();
  imu_.clear();
  rotors_.clear();
  last_look_.reset();
}

}  // namespace odmc
