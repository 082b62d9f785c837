#include "odmc/io/entry_stamps.h"

#include <algorithm>
#include <utility>

#include "odmc/math/statistics.h"
#include "odmc/sensing/topic_clock.h"

namespace odmc {
namespace {

constexpr size_t kKept = 16;             // readings of an entry, for its usual interval
constexpr Stamp kMostIntervals = 4;      // of silence
constexpr double kAnotherClock_s = 1.0;  // no link is so slow for long: the messages' clock was set
constexpr int kMostFarOff = 100;         // messages that are
constexpr double kDrift = 1e-4;          // of one clock against the other, at most

template <typename Readings>
Stamp UsualStep(const Readings& readings) {
  std::vector<Stamp> steps;
  for (size_t i = 1; i < readings.size(); ++i) {
    steps.push_back(readings[i].stamp - readings[i - 1].stamp);
  }
  return MiddleOf(std::move(steps));
}

}  // namespace

std::optional<ForeignReading> EntryAligner::Add(const std::vector<double>& values,
                                                const std::vector<Stamp>& stamps) {
  if (entries_.size() != values.size()) {
    entries_.assign(values.size(), {});
    last_ = 0;
  }
  for (size_t i = 0; i < values.size(); ++i) {
    Readings* readings = &entries_[i];
    const bool is_first = readings->empty();
    if (stamps[i] == 0) continue;
    if (!is_first && IsStepBack(readings->back().stamp, stamps[i])) {
      for (Readings& all : entries_) all.clear();
      last_ = 0;
    } else if (!is_first && stamps[i] <= readings->back().stamp) {
      continue;
    }
    readings->push_back({stamps[i], values[i]});
    if (readings->size() > kKept) readings->pop_front();
  }
  const auto has_none = [](const Readings& readings) { return readings.empty(); };
  if (std::any_of(entries_.begin(), entries_.end(), has_none)) return std::nullopt;
  ForeignReading reading{entries_[0].back().stamp, {}};
  for (const Readings& readings : entries_) {
    reading.stamp = std::min(reading.stamp, readings.back().stamp);
  }
  if (reading.stamp <= last_) return std::nullopt;
  for (const Readings& readings : entries_) {
    const std::optional<double> value = At(readings, reading.stamp);
    if (!value) return std::nullopt;
    reading.values.push_back(*value);
  }
  last_ = reading.stamp;
  return reading;
}

/// @pre the newest reading is not before `stamp`
std::optional<double> EntryAligner::At(const Readings& readings, Stamp stamp) {
  size_t next = readings.size() - 1;
  while (next > 0 && readings[next - 1].stamp >= stamp) --next;
  if (readings[next].stamp == stamp) return readings[next].value;
  if (next == 0) return std::nullopt;
  const Reading &before = readings[next - 1], &after = readings[next];
  const Stamp gap = after.stamp - before.stamp;
  if (gap > kMostIntervals * UsualStep(readings)) return std::nullopt;
  const double share = static_cast<double>(stamp - before.stamp) / static_cast<double>(gap);
  return before.value + share * (after.value - before.value);
}

Stamp OwnClock::Follow(Stamp own, Stamp message) {
  const Stamp offset = message - own;
  const bool is_off = offset_ && ToSeconds(offset - *offset_) > kAnotherClock_s;
  far_off_ = is_off ? far_off_ + 1 : 0;
  const bool has_restarted = offset_ && IsStepBack(last_own_, own);
  if (!offset_ || has_restarted || far_off_ > kMostFarOff) {
    offset_ = offset;
    far_off_ = 0;
  } else {
    const auto drift = static_cast<Stamp>(kDrift * static_cast<double>(own - last_own_));
    offset_ = std::min(offset, *offset_ + std::max<Stamp>(drift, 0));
  }
  last_own_ = own;
  return *offset_;
}

}  // namespace odmc
