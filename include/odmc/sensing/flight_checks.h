#pragma once

#include <string>
#include <vector>

#include "odmc/sensing/samples.h"

namespace odmc {

/// \file
/// What every reader of recorded flights does to the samples it read, whatever their format.

/// Counts samples refused for one reason, and makes one warning of them.
struct RefusedSamples {
  long count = 0;
  std::string first;  ///< where the first one was

  void Add(const std::string& where) {
    if (count++ == 0) first = where;
  }
  /// Adds to the log's `dropped` and, if there are any, a warning "FILE: N `what` (first: WHERE)".
  void Report(const std::string& source, const std::string& what, FlightLog* log) const;
};

/// True if all numbers that the sample has are finite, and an IMU sample has any.
bool IsFinite(const OdometrySample& sample);
bool IsFinite(const ImuSample& sample);

/// True if a pose repeats the other to the last digit.
bool IsSamePose(const OdometrySample& a, const OdometrySample& b);

/// True if the last of `stamps` leapt ahead by more than a second and is alone with it: `next` goes
/// on from the one before. One stamp is wrong then, not all that follow.
bool IsLoneLeap(const std::vector<Stamp>& stamps, Stamp next);

/// Drops samples whose stamp does not step forward, and single ones that leap ahead of all after
/// them; counted in `log`, one warning each. Refuses streams that are mostly out of order.
/// @throws std::invalid_argument naming `source`
template <typename Sample>
void KeepForward(const std::string& source, std::vector<Sample>* samples, FlightLog* log);

/// Makes attitudes unit and their sign continuous. Attitudes that are unit to the last bits are
/// left alone, so that writing and reading changes nothing. Drops single samples that are off by
/// more than 5 %, counted in `log`.
/// @throws std::invalid_argument naming `source` if most are off.
void NormaliseAttitudes(const std::string& source, std::vector<OdometrySample>* samples,
                        FlightLog* log);

/// Takes the magnitude of speeds that carry a sign for the direction of turning; one warning.
void TakeSpeedMagnitudes(const std::string& source, FlightLog* log);

/// Warns of rotors that read zero, or one same value for half a second, while the others turn; not
/// of those that were told to stand.
void WarnOfDeadRotors(const std::string& source, FlightLog* log);

/// Takes back what WarnOfDeadRotors() said, since their speeds were replaced.
void ForgetDeadRotors(FlightLog* log);

/// Puts poses of motion capture in the odometry's place. The odometry's velocity goes with it; its
/// body rates stay: they move, on their own stamps, to the IMU stream unless that has a gyro
/// already.
void UseMocapPoses(std::vector<OdometrySample> mocap, FlightLog* log);

}  // namespace odmc
