#pragma once

#include "odmc/math/ring.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// What no sensor of a multirotor reads. Samples beyond are dropped as if they were not finite.
constexpr double kMostDistance_m = 1e8;  // from the world's origin; coordinates of a country fit in
constexpr double kMostSpeed_m_s = 1000.0;
constexpr double kMostRate_rad_s = 100.0;  // 5700 °/s
constexpr double kMostSpecificForce_m_s2 = 2000.0;
constexpr double kMostRotorSpeed_rad_s = 2e4;  // 190 000 rpm

/// True if every number is finite and one that a sensor can read; the quaternion is about unit,
/// rotor speeds are not negative.
bool IsPlausible(const OdometrySample& sample);
bool IsPlausible(const ImuSample& sample);
bool IsPlausible(const RotorSample& sample);

/// True if body rates leap away from those before and the turn between the two poses says
/// otherwise. (Stamps that jitter make rates and turn disagree, too, but then nothing leaps.)
bool ContradictsTurn(const OdometrySample& before, const OdometrySample& sample);

/// True if the newest sample leaps so far from the one before that it may be a glitch; the next one
/// tells.
bool MayBeGlitch(const Ring<RotorSample>& queue);
bool MayBeGlitch(const Ring<ImuSample>& queue);

/// Where the last sample but one leaps away from both of its neighbours (within 50 ms), puts the
/// line between these in its place, number by number. @returns true if there was such a one
bool MendGlitch(Ring<RotorSample>* queue);
bool MendGlitch(Ring<ImuSample>* queue);

/// Leaves rates out where many are beyond what a sensor reads (another unit), then drops from a
/// whole recording what IsPlausible() refuses, poses whose rates ContradictsTurn(), and readings
/// that TakeDropouts() finds missing, and mends its glitches; a warning each names stream, number
/// and first time.
void MendFlight(FlightLog* log);

}  // namespace odmc
