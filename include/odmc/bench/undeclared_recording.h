#pragma once

#include <optional>

#include "odmc/model/vehicle.h"
#include "odmc/sensing/samples.h"
#include "odmc/sim/simulator.h"

namespace odmc {

/// How the conditions are drawn under which a test flight is recorded.
enum class RecordingModel {
  kWhite,        ///< white noise of sizes drawn about one set, 250 Hz, the body's own odometry
  kDrawn,        ///< a quarter as kWhite; else rate, mount, pilot, coloured noise, jitter drawn too
  kIndependent,  ///< as of a simulator of another author, with an IMU at an unknown place
};

/// What a flight is recorded with. Nothing of it is an effect that the declared model lacks: the
/// odometry's mount is in the vehicle file, an IMU's is estimated, and stamps are late by nothing
/// on average (rotor stamps that are late are the effect rotor_delay).
struct RecordingConditions {
  RecordingModel model = RecordingModel::kWhite;  ///< as drawn: kWhite for the quarter of kDrawn
  SimulationNoise noise;                          ///< white parts
  double log_rate_hz = 250.0;
  double pilot_bandwidth = 1.0;       ///< as in SimulationOptions
  SensorMount odometry;               ///< true and declared
  std::optional<SensorMount> imu;     ///< true; declared at Bo and estimated
  double slow_velocity_m_s = 0.0;     ///< standard deviation per axis of a first-order process
  double slow_time_constant_s = 1.0;  ///< of that process [s]
  double rotor_quantum_rad_s = 0.0;   ///< rotor speeds are multiples of this; 0: exact
  double vibration_rad_s = 0.0;       ///< amplitude on rates of a line at each rotor's frequency
  double stamp_jitter_s = 0.0;        ///< standard deviation, of every sample on its own
};

const char* NameOf(RecordingModel model);

/// The conditions of the flight with this seed.
RecordingConditions DrawRecording(RecordingModel model, int seed, const Vehicle& vehicle);

/// Adds to an otherwise recorded flight what SimulationNoise has not: slow noise, vibration,
/// quantization, jitter.
void Degrade(const RecordingConditions& conditions, int seed, FlightLog* log);

/// What the vehicle file says of the sensors: the odometry's place as it is, the IMU's not at all.
void DeclareSensors(const RecordingConditions& conditions, Vehicle* vehicle);

}  // namespace odmc
