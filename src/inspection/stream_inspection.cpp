#include "odmc/inspection/stream_inspection.h"

#include <algorithm>
#include <cmath>

#include "odmc/inspection/motion_checks.h"
#include "odmc/inspection/vehicle_checks.h"
#include "odmc/sensing/stream_pace.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

// Beyond these a stream is said to be stamped wrongly. Rotor speeds are read where they are used;
// what a rate, velocity or accelerometer went through before (filters at 20 to 100 Hz, an onboard
// observer) makes it up to 10 ms late or early against the pose by itself. That lag is taken off as
// any other, without a word.
constexpr double kLeastRotorOffset_s = 0.005, kLeastFilterOffset_s = 0.010;
constexpr double kSigmas = 3.0;
// No filter and no controller makes a lag this long: two sigmas do. (An accelerometer feels what
// the pose does not show, blows and vibration, and is left its three.)
constexpr double kLaterThanFilters_s = 0.03, kSigmasOfLongOnes = 2.0;
// What an observer's own lag is, StreamLag::pull_s says. A wrong stamp is besides a lag of the
// whole: taking it off cures part of the disagreement. (An accelerometer shows a swinging load that
// the pose does not; it must cure half.)
constexpr double kVelocityCured = 0.05, kAccelerometerCured = 0.5;
constexpr double kWellKnown_s = 0.01;

// Every second stream has an offset, of some 20 ms: of seven vehicles' recordings, in five rotor
// speeds and poses are 8 to 40 ms apart (docs/fault_campaign.md).
constexpr double kOffsetsAre = 0.5, kOffsetSize_s = 0.02;
constexpr double kNoOffset_s = 0.001;  // changes nothing worth a replay

std::string Milliseconds(double seconds) { return Format("%.1f ms", 1e3 * std::abs(seconds)); }

std::string Called(const std::string& stream) {
  if (stream == "rotor_speeds") return "rotor speeds are";
  if (stream == "body_rates") return "body rates are";
  if (stream == "gyro") return "gyro is";
  if (stream == "accelerometer") return "accelerometer is";
  return "velocity is";
}

double MustCure(const std::string& stream) {
  if (stream == "accelerometer") return kAccelerometerCured;
  return stream == "velocity" ? kVelocityCured : 0.0;
}

/// True if the lag is there, and is one that a shift takes off.
bool Stands(const TimeOffset& offset) {
  const StreamLag& lag = offset.lag;
  const double size_s = std::abs(lag.lag_s);
  if (!lag.determined() || size_s < kNoOffset_s) return false;
  const bool is_long = size_s > kLaterThanFilters_s && offset.stream != "accelerometer";
  const double sigmas = is_long ? kSigmasOfLongOnes : kSigmas;
  return size_s > sigmas * lag.sigma_s() && lag.cured > MustCure(offset.stream);
}

/// The same of rotor speeds, whose lag is judged from the clock that they are thought to keep.
bool RotorsStand(const StreamLag& lag, double clock_s) {
  const double size_s = std::abs(lag.lag_s - clock_s);
  if (!lag.determined() || size_s < kLeastRotorOffset_s) return false;
  const double sigmas = size_s > kLaterThanFilters_s ? kSigmasOfLongOnes : kSigmas;
  // Where answers of the controller are most of what the flight shows, their lag may be found in
  // place of the stamps', 45 ms off. There the stamps as they are must explain less.
  return size_s > sigmas * lag.sigma_s() &&
         (lag.sigma_s() < kWellKnown_s || lag.over_none >= kLeastContrast);
}

/// What is not known of an offset after it was taken off, or was not.
void AddDoubt(const TimeOffset& offset, StreamInspection* inspection) {
  const StreamLag& lag = offset.lag;
  if (offset.stream == "accelerometer") return;
  double late_s = lag.sigma_s();
  if (!lag.determined()) {  // the flight does not show it: what is known beforehand
    late_s = RareErrorPosterior(0.0, 1e3 * kOffsetSize_s, kOffsetsAre, kOffsetSize_s).rms();
  } else if (offset.compensated_s == 0.0) {
    late_s = RareErrorPosterior(lag.lag_s, lag.sigma_s(), kOffsetsAre, kOffsetSize_s).rms();
    late_s = std::copysign(late_s, lag.lag_s);
  }
  if (std::abs(late_s) < kNoOffset_s) return;
  inspection->doubts.push_back({offset.stream, late_s});
}

/// Adds an offset, and what follows from it. @returns what was compensated [s]
double Take(std::optional<TimeOffset> offset, StreamInspection* inspection) {
  if (!offset) return 0.0;
  if (Stands(*offset)) {
    offset->compensated_s = offset->lag.lag_s;
    if (std::abs(offset->lag.lag_s) > kLeastFilterOffset_s) {
      inspection->findings.push_back(OffsetFinding(*offset, true));
    }
  }
  AddDoubt(*offset, inspection);
  inspection->offsets.push_back(*offset);
  return offset->compensated_s;
}

/// Rotor speeds. No filter makes a turn rate early: where it is, the attitude is late, or the rates
/// are stamped early. Rotor speeds with right stamps are early with them, or not: what they show.
/// @param rates_s how late the rates are that they were compared with
void TakeRotors(std::optional<TimeOffset> offset, double rates_s, StreamInspection* inspection) {
  if (!offset) return;
  const StreamLag& lag = offset->lag;
  double clock_s = std::min(0.0, rates_s);
  if (lag.determined() && std::abs(lag.lag_s) < std::abs(lag.lag_s - clock_s)) clock_s = 0.0;
  offset->compensated_s = clock_s;
  if (RotorsStand(offset->lag, clock_s)) {
    offset->compensated_s = offset->lag.lag_s;
    inspection->findings.push_back(OffsetFinding(*offset, true));
  }
  AddDoubt(*offset, inspection);
  inspection->offsets.push_back(*offset);
}

/// The IMU's two sensors share their stamps, and the gyro shows them better.
/// @returns what was compensated [s]
double TakeImu(const MotionSignals& signals, const Vehicle& vehicle,
               const std::vector<bool>& flight, StreamInspection* inspection) {
  const auto gyro = GyroOffset(signals, flight);
  const bool gyro_tells = gyro && gyro->lag.determined();
  const double gyro_s = Take(gyro, inspection);
  const auto accelerometer = AccelerometerOffset(signals, vehicle, flight);
  if (!accelerometer) return gyro_s;
  if (gyro_tells) {
    inspection->offsets.push_back(*accelerometer);
    return gyro_s;
  }
  return Take(accelerometer, inspection);
}

/// An offset against a stream that was late itself.
void Add(const std::optional<TimeOffset>& reference, std::optional<TimeOffset>* offset) {
  if (!reference || !*offset || (*offset)->against != reference->stream) return;
  if (reference->compensated_s == 0.0) return;
  StreamLag& lag = (*offset)->lag;
  lag.lag_s += reference->compensated_s;
  lag.pull_s = std::hypot(lag.pull_s, reference->lag.sigma_s());
}

/// What was found of a stream.
std::optional<TimeOffset> Found(const std::string& stream, const StreamInspection& inspection) {
  for (const TimeOffset& offset : inspection.offsets) {
    if (offset.stream == stream) return offset;
  }
  return std::nullopt;
}

void InspectOffsets(const MotionSignals& signals, const Vehicle& vehicle,
                    const std::vector<bool>& flight, StreamInspection* inspection) {
  Take(VelocityOffset(signals, flight), inspection);
  Take(RatesOffset(signals, flight), inspection);
  TakeImu(signals, vehicle, flight, inspection);
  auto torque = RotorOffset(signals, vehicle, flight);
  auto thrust = ThrustOffset(signals, vehicle, flight);
  double rates_s = 0.0;
  for (const char* stream : {"velocity", "body_rates", "gyro"}) {
    const auto reference = Found(stream, *inspection);
    if (reference && torque && torque->against == stream) rates_s = reference->compensated_s;
    Add(reference, &torque);
    Add(reference, &thrust);
  }
  if (torque) CheckInertia(signals, vehicle, flight, *torque, inspection);
  TakeRotors(CombinedOffset(torque, thrust), rates_s, inspection);
}

/// What happens between samples that are far apart.
void DoubtSparse(const std::string& stream, const StreamPace& pace, double sparse_s,
                 StreamInspection* inspection) {
  if (pace.step_s() <= sparse_s) return;
  StreamDoubt doubt;
  doubt.stream = stream;
  doubt.sparse_s = pace.step_s();
  inspection->doubts.push_back(doubt);
}

}  // namespace

Finding OffsetFinding(const TimeOffset& offset, bool taken_off) {
  const StreamLag& lag = offset.lag;
  const bool sure = lag.sigma_s() < kWellKnown_s;
  Finding finding;
  finding.check = offset.stream + "_offset";
  finding.leaves = sure && taken_off ? Trust::kGood : Trust::kDoubtful;
  finding.what = Called(offset.stream) + " stamped " + Milliseconds(lag.lag_s) +
                 (lag.lag_s > 0.0 ? " late" : " early") + " (sigma " + Milliseconds(lag.sigma_s()) +
                 ", against " + offset.against + ")" + (taken_off ? "; this was taken off" : "");
  finding.mend = sure ? "mend the stamps at the source"
                      : "mend the stamps at the source, or fly livelier: the flight shows the "
                        "offset badly";
  return finding;
}

StreamInspection InspectStreams(const FlightLog& log, const Vehicle& vehicle) {
  StreamInspection inspection;
  CheckVehicleUnits(vehicle, &inspection);
  if (!inspection.refusal.empty()) return inspection;
  CheckInertiaBounds(vehicle, &inspection);
  CheckGravity(vehicle, &inspection);
  std::optional<MotionSignals> signals = SignalsOf(log);
  if (!signals) return inspection;
  const std::vector<bool> flight = FindFlight(*signals);
  CheckMotion(vehicle, flight, &*signals, &inspection);
  if (!inspection.refusal.empty()) return inspection;
  CheckThrust(*signals, vehicle, flight, &inspection);
  if (!inspection.refusal.empty()) return inspection;
  InspectOffsets(*signals, vehicle, flight, &inspection);
  DoubtSparse("odometry", PaceOf(log.odometry), kSparse_s, &inspection);
  DoubtSparse("rotor_speeds", PaceOf(log.rotors), kSparseRotors_s, &inspection);
  return inspection;
}

}  // namespace odmc
