#pragma once

#include <functional>
#include <optional>
#include <string>
#include <utility>

#include "odmc/math/ring.h"
#include "odmc/sensing/rotor_dropout.h"
#include "odmc/sensing/samples.h"
#include "odmc/sensing/stream_pace.h"

namespace odmc {

/// What the synchroniser refused or lost.
struct SynchroniserCounters {
  long not_finite = 0;      ///< samples no sensor reads: NaN, infinity, beyond IsPlausible()
  long glitches = 0;        ///< samples that leapt away and came back (MendGlitch(), or body rates
                            ///< that contradict the turn: dropped)
  Stamp first_glitch = 0;   ///< of the first of these
  long rotor_dropouts = 0;  ///< times that rotor speeds fell to nothing and came back at once
  RotorDropout first_dropout;
  long out_of_order = 0;   ///< stamps that step back or repeat
  long repeated_pose = 0;  ///< poses identical to the one before (a stalled source)
  long uncovered = 0;  ///< keyframes let go without rotor speeds or IMU because those stayed away
};

/// Merges the streams by stamp and picks keyframes from the odometry. Knows which stream it waits
/// for. Thread-compatible: its owner guards it.
class Synchroniser {
 public:
  /// @param keyframe_rate_hz at most this many keyframes a second
  /// @param patience_s how far odometry may run ahead of a silent stream before going on without it
  Synchroniser(double keyframe_rate_hz, double patience_s);

  /// @returns false if the sample is dropped (and counted)
  bool Add(const OdometrySample& sample);
  void Add(const ImuSample& sample);
  /// @returns false if the sample is dropped (and counted)
  bool Add(const RotorSample& sample);
  void Add(const BatterySample& sample);

  /// Says that no more samples will come: what is left is handed out without waiting.
  void Finish() { finished_ = true; }

  /// Makes streams be waited for in the time of arrival, too. A program that stood still, or a link
  /// that stalled, hands out the backlog of one stream before that of the next: stamps alone would
  /// take the second for silent.
  /// @param now_s a clock that never steps, in seconds; without one, stamps alone decide
  void SetArrivalClock(std::function<double()> now_s) { now_s_ = std::move(now_s); }

  /// The next keyframe's odometry, once every stream has reached it; empty while waiting.
  std::optional<OdometrySample> NextKeyframe();

  /// True once every stream has come as far as `stamp`, or is not waited for any more.
  bool HasReached(Stamp stamp) const;

  /// Name of the stream the next keyframe waits for; empty if none.
  const std::string& waiting_for() const { return waiting_for_; }

  const Ring<RotorSample>& rotors() const { return rotors_; }
  const Ring<ImuSample>& imu() const { return imu_; }
  const StreamPace& odometry_pace() const { return odometry_pace_; }
  const StreamPace& rotor_pace() const { return rotor_pace_; }
  double battery_voltage_V() const { return battery_voltage_V_; }
  const SynchroniserCounters& counters() const { return counters_; }
  Stamp newest_odometry() const { return last_odometry_ ? last_odometry_->stamp : 0; }

  /// Forgets samples older than needed after keyframe `stamp`.
  void Trim(Stamp stamp);

  /// Forgets everything; the next samples may start at any stamp.
  void Clear();

 private:
  struct Waiting {
    OdometrySample sample;
    double spacing_s = 0.0;  // of the odometry up to it, whatever has come since
    double arrived_s = 0.0;
  };
  /// The stream that has not reached `stamp`, empty if none.
  std::string Lagging(Stamp stamp) const;
  bool IsPatient(Stamp stamp) const;
  /// The odometry that reached `stamp` came just now: what belongs to it may be on its way.
  bool HasJustArrived(Stamp stamp) const;
  bool Covered(Stamp stamp);
  bool IsDue(const Waiting& next) const;

  double period_s_, patience_s_;
  std::function<double()> now_s_;
  Ring<Waiting> odometry_;
  Ring<RotorSample> rotors_;
  RotorDropoutWatch dropouts_;
  Ring<ImuSample> imu_;
  double battery_voltage_V_ = 0.0;
  std::optional<OdometrySample> last_odometry_;
  std::optional<Stamp> last_keyframe_;
  StreamPace odometry_pace_, rotor_pace_;
  bool finished_ = false;
  std::string waiting_for_;
  SynchroniserCounters counters_;
};

}  // namespace odmc
