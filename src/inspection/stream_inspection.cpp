#include "odmc/inspection/stream_inspection.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "odmc/inspection/motion_checks.h"

namespace odmc {
namespace {

// Beyond these a stream is taken to be stamped wrongly. Rotor speeds are read where they are used;
// what a rate, velocity or accelerometer went through before (filters at 20 to 100 Hz, an onboard
// observer) makes it up to 10 ms late or early against the pose by itself.
constexpr double kLeastRotorOffset_s = 0.005, kLeastFilterOffset_s = 0.010;
constexpr double kSigmas = 3.0;
// An onboard observer's velocity lags its position by up to 30 ms in part of its band (jana04), an
// accelerometer shows a swinging load that the pose does not. A wrong stamp is a lag of the whole:
// taking it off must cure this share of the disagreement, or of a lag longer than filters have a
// part that is not noise.
constexpr double kRatesCured = 0.2, kVelocityCured = 0.4, kAccelerometerCured = 0.5;
constexpr double kLaterThanFilters_s = 0.04, kLeastCured = 0.1;
constexpr double kWellKnown_s = 0.005;

std::string Milliseconds(double seconds) {
  char text[32];
  std::snprintf(text, sizeof text, "%.1f ms", 1e3 * std::abs(seconds));
  return text;
}

std::string Called(const std::string& stream) {
  if (stream == "rotor_speeds") return "rotor speeds are";
  if (stream == "body_rates") return "body rates are";
  if (stream == "gyro") return "gyro is";
  if (stream == "accelerometer") return "accelerometer is";
  return "velocity is";
}

double MustCure(const std::string& stream, double size_s) {
  if (stream == "accelerometer") return kAccelerometerCured;
  if (stream != "velocity") return kRatesCured;
  return size_s > kLaterThanFilters_s ? kLeastCured : kVelocityCured;
}

bool IsWrong(const TimeOffset& offset) {
  const Lag& lag = offset.lag;
  const double size_s = std::abs(lag.lag_s);
  if (!lag.determined() || size_s < kSigmas * lag.sigma_s()) return false;
  if (offset.stream == "rotor_speeds") return size_s > kLeastRotorOffset_s;
  return size_s > kLeastFilterOffset_s && lag.cured > MustCure(offset.stream, size_s);
}

Finding OffsetFinding(const TimeOffset& offset) {
  const Lag& lag = offset.lag;
  const bool sure = lag.sigma_s() < kWellKnown_s;
  Finding finding;
  finding.check = offset.stream + "_offset";
  finding.leaves = sure ? Trust::kGood : Trust::kDoubtful;
  finding.what = Called(offset.stream) + " stamped " + Milliseconds(lag.lag_s) +
                 (lag.lag_s > 0.0 ? " late" : " early") + " (sigma " +
                 Milliseconds(lag.sigma_s()) + ", against " + offset.against +
                 "); this was taken off";
  finding.mend = sure ? "mend the stamps at the source"
                      : "mend the stamps at the source, or fly livelier: the flight shows the "
                        "offset badly";
  return finding;
}

/// Adds an offset, and what follows from it. @returns what was compensated [s]
double Take(std::optional<TimeOffset> offset, StreamInspection* inspection) {
  if (!offset) return 0.0;
  if (IsWrong(*offset)) {
    offset->compensated_s = offset->lag.lag_s;
    inspection->findings.push_back(OffsetFinding(*offset));
  }
  inspection->offsets.push_back(*offset);
  return offset->compensated_s;
}

/// The IMU's two sensors share their stamps, and the gyro shows them better.
void TakeImu(const MotionSignals& signals, const Vehicle& vehicle, const std::vector<bool>& flight,
             StreamInspection* inspection) {
  const auto gyro = GyroOffset(signals, flight);
  const bool gyro_tells = gyro && gyro->lag.determined();
  Take(gyro, inspection);
  const auto accelerometer = AccelerometerOffset(signals, vehicle, flight);
  if (!accelerometer) return;
  if (gyro_tells) {
    inspection->offsets.push_back(*accelerometer);
  } else {
    Take(accelerometer, inspection);
  }
}

void InspectOffsets(const MotionSignals& signals, const Vehicle& vehicle,
                    const std::vector<bool>& flight, StreamInspection* inspection) {
  Take(VelocityOffset(signals, flight), inspection);
  const double rates_s = Take(RatesOffset(signals, flight), inspection);
  TakeImu(signals, vehicle, flight, inspection);
  auto rotors = RotorOffset(signals, vehicle, flight);
  const auto thrust = ThrustOffset(signals, vehicle, flight);
  // One speed for all rotors moves no torque.
  if (!rotors || (thrust && !rotors->lag.determined() && thrust->lag.determined())) rotors = thrust;
  if (!rotors) return;
  // Relative to rates that are late themselves.
  if (rotors->against == "body_rates") rotors->lag.lag_s += rates_s;
  Take(rotors, inspection);
}

}  // namespace

StreamInspection InspectStreams(const FlightLog& log, const Vehicle& vehicle) {
  StreamInspection inspection;
  std::optional<MotionSignals> signals = SignalsOf(log);
  if (!signals) return inspection;
  const std::vector<bool> flight = FindFlight(*signals);
  CheckMotion(vehicle, flight, &*signals, &inspection);
  InspectOffsets(*signals, vehicle, flight, &inspection);
  return inspection;
}

}  // namespace odmc
