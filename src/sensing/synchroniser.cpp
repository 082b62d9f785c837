#include "odmc/sensing/synchroniser.h"

#include <algorithm>
#include <cmath>

#include "odmc/sensing/flight_checks.h"
#include "odmc/sensing/plausible.h"
#include "odmc/sensing/push_newest.h"

namespace odmc {
namespace {

bool IsSame(const OdometrySample& a, const OdometrySample& b) {
  return IsSamePose(a, b) && a.v_WS == b.v_WS && a.w_WS_S == b.w_WS_S;
}

/// Appends in order; counts what steps back, and mends what leapt away and came back.
/// @returns false if the sample is refused
template <typename Sample>
bool Append(const Sample& sample, Ring<Sample>* queue, SynchroniserCounters* counters) {
  if (!IsPlausible(sample)) {
    ++counters->not_finite;
    return false;
  }
  if (!queue->empty() && sample.stamp <= queue->back().stamp) {
    ++counters->out_of_order;
    return false;
  }
  PushNewest(sample, queue);
  if (!MendGlitch(queue)) return true;
  if (counters->glitches++ == 0) counters->first_glitch = (*queue)[queue->size() - 2].stamp;
  return true;
}

/// How far a stream can be relied on: a newest sample that may be a glitch waits for the next one.
template <typename Sample>
Stamp ReliableTo(const Ring<Sample>& queue) {
  return MayBeGlitch(queue) ? queue[queue.size() - 2].stamp : queue.back().stamp;
}

template <typename Sample>
void DropBefore(Stamp stamp, Ring<Sample>* queue) {
  while (queue->size() > 2 && (*queue)[1].stamp < stamp) queue->pop_front();
}

}  // namespace

Synchroniser::Synchroniser(double keyframe_rate_hz, double patience_s)
    : period_s_(1.0 / keyframe_rate_hz), patience_s_(patience_s) {}

bool Synchroniser::Add(const OdometrySample& received) {
  if (!IsPlausible(received)) {
    ++counters_.not_finite;
    return false;
  }
  OdometrySample sample = received;
  sample.q_WS.normalize();
  if (last_odometry_) {
    if (sample.stamp <= last_odometry_->stamp) {
      ++counters_.out_of_order;
      return false;
    }
    if (ContradictsTurn(*last_odometry_, sample)) {
      if (counters_.glitches++ == 0) counters_.first_glitch = sample.stamp;
      return false;
    }
    if (IsSame(sample, *last_odometry_)) {
      ++counters_.repeated_pose;
      return false;
    }
  }
  odometry_pace_.Add(sample.stamp);
  last_odometry_ = sample;
  odometry_.push_back({sample, odometry_pace_.step_s(), now_s_ ? now_s_() : 0.0});
  return true;
}

void Synchroniser::Add(const ImuSample& sample) { Append(sample, &imu_, &counters_); }

bool Synchroniser::Add(const RotorSample& sample) {
  if (!Append(sample, &rotors_, &counters_)) return false;
  rotor_pace_.Add(sample.stamp);
  const std::optional<RotorDropout> ended = dropouts_.Sift(&rotors_);
  if (ended && counters_.rotor_dropouts++ == 0) counters_.first_dropout = *ended;
  return true;
}

void Synchroniser::Add(const BatterySample& sample) {
  if (std::isfinite(sample.voltage_V)) battery_voltage_V_ = sample.voltage_V;
}

bool Synchroniser::IsDue(const Waiting& next) const {
  if (!last_keyframe_) return true;
  return ToSeconds(next.sample.stamp - *last_keyframe_) >= period_s_ - 0.5 * next.spacing_s;
}

std::string Synchroniser::Lagging(Stamp stamp) const {
  if (rotors_.empty() || ReliableTo(rotors_) < stamp) return "rotor_speeds";
  if (!imu_.empty() && ReliableTo(imu_) < stamp) return "imu";
  return "";
}

bool Synchroniser::IsPatient(Stamp stamp) const {
  if (finished_) return false;
  return ToSeconds(newest_odometry() - stamp) < patience_s_ || HasJustArrived(stamp);
}

bool Synchroniser::HasJustArrived(Stamp stamp) const {
  if (!now_s_) return false;
  for (size_t i = 0; i < odometry_.size(); ++i) {
    if (odometry_[i].sample.stamp >= stamp) return now_s_() - odometry_[i].arrived_s < patience_s_;
  }
  return false;
}

bool Synchroniser::HasReached(Stamp stamp) const {
  return newest_odometry() >= stamp && (Lagging(stamp).empty() || !IsPatient(stamp));
}

bool Synchroniser::Covered(Stamp stamp) {
  waiting_for_ = Lagging(stamp);
  if (waiting_for_.empty()) return true;
  if (IsPatient(stamp)) return false;
  ++counters_.uncovered;
  return true;
}

std::optional<OdometrySample> Synchroniser::NextKeyframe() {
  while (!odometry_.empty()) {
    const OdometrySample sample = odometry_.front().sample;
    if (!IsDue(odometry_.front())) {
      odometry_.pop_front();
      continue;
    }
    if (!Covered(sample.stamp)) return std::nullopt;
    odometry_.pop_front();
    last_keyframe_ = sample.stamp;
    return sample;
  }
  waiting_for_ = "odometry";
  return std::nullopt;
}

void Synchroniser::Trim(Stamp stamp) {
  DropBefore(stamp, &rotors_);
  DropBefore(stamp, &imu_);
}

void Synchroniser::Clear() {
  odometry_.clear();
  rotors_.clear();
  dropouts_.Clear();
  imu_.clear();
  last_odometry_.reset();
  last_keyframe_.reset();
  odometry_pace_ = rotor_pace_ = StreamPace();
  finished_ = false;
  waiting_for_.clear();
}

}  // namespace odmc
