#pragma once

#include <deque>
#include <optional>
#include <vector>

#include "odmc/inspection/stream_inspection.h"

namespace odmc {

/// Watches the streams of a running node: keeps the newest seconds of every stream and compares
/// them with each other now and then. Feeding it costs a copy of the sample; the comparison about
/// 0.1 s of CPU time, so ask for it in a thread of low priority. Thread-compatible.
class StreamWatch {
 public:
  /// What is kept, and how often it is looked at.
  struct Options {
    double keep_s = 60.0;       ///< newest seconds that are kept
    double every_s = 10.0;      ///< of time between two looks, by the samples' stamps
    long most_samples = 60000;  ///< of each stream, whatever its rate
  };

  explicit StreamWatch(const Vehicle& vehicle) : StreamWatch(vehicle, Options()) {}
  StreamWatch(const Vehicle& vehicle, const Options& options);

  /// Samples of one stream in the order of their stamps; one that steps back clears everything.
  void Add(const OdometrySample& sample);
  void Add(const ImuSample& sample);
  void Add(const RotorSample& sample);

  /// True if enough time has passed since the last look.
  bool IsDue() const;

  /// The newest seconds as a log, to be looked at elsewhere; counts as a look.
  FlightLog TakeLook();

  void Clear();

 private:
  template <typename Sample>
  void Push(const Sample& sample, std::deque<Sample>* stream);
  /// Samples that are not older than the odometry that is kept: a stream may have stopped.
  template <typename Sample>
  std::vector<Sample> Newest(const std::deque<Sample>& stream) const;

  Vehicle vehicle_;
  Options options_;
  std::deque<OdometrySample> odometry_;
  std::deque<ImuSample> imu_;
  std::deque<RotorSample> rotors_;
  std::optional<Stamp> last_look_;
};

}  // namespace odmc
