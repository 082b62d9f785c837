#pragma once

#include <optional>
#include <string>
#include <vector>

#include "odmc/analysis/calibration.h"
#include "odmc/model/vehicle.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// One stream of a recording in numbers.
struct StreamFigures {
  std::string name;                ///< poses, IMU, rotor speeds, battery, commands
  std::vector<std::string> holds;  ///< what is in it: velocity, body rates, gyro, accelerometer
  long samples = 0;
  double rate_Hz = 0.0;  ///< one over the median step
  double longest_gap_s = 0.0;
  long gaps = 0;          ///< steps longer than three median ones
  double jitter_s = 0.0;  ///< spread of the steps: their interquartile range over 1.35
  long repeated = 0;      ///< samples that repeat the one before to the last digit
};

/// What a flight covers, on the ground left out.
struct FlownFigures {
  double speed_m_s = 0.0, climb_m_s = 0.0;  ///< 99th percentile of speed, and of |climb rate|
  double rate_rad_s = 0.0;                  ///< the same of the body rate
  double height_range_m = 0.0;
  double flight_s = 0.0;
};

/// What a flight says about one parameter of the declared model.
struct ParameterObservability {
  std::string full_name, unit;
  double value = 0.0, sigma = 0.0;
  double prior_sigma = 0.0;
  bool is_shown = false;
  std::string manoeuvre;  ///< what would show it, where it is not
};

/// Which places and spins would fit the rotor speeds, where there is no vehicle file.
struct RotorGuess {
  std::string frame;                                         ///< "quad_x"
  std::vector<std::string> places;                           ///< per reading, "front left"
  std::vector<std::string> spins;                            ///< per reading, "cw" or "ccw"
  bool places_told = false, spins_told = false;              ///< false: a guess
  double places_probability = 0.0, spins_probability = 0.0;  ///< 0: the flight says nothing
  std::optional<double> hover_speed_rad_s;                   ///< of each rotor
  std::vector<std::string> advice;  ///< what the flight does not tell, and what to fly
};

/// What a colleague would say after a look at a recording.
struct FlightInspection {
  std::string file, vehicle;
  double duration_s = 0.0;
  std::vector<StreamFigures> streams;  ///< as recorded
  StreamInspection inspection;         ///< findings of streams and vehicle file, offsets, refusal
  std::vector<PhaseSpan> phases;
  Stamp first_stamp = 0;
  std::optional<FlownFigures> flown;            ///< empty: never airborne
  std::vector<ParameterObservability> lessons;  ///< empty where nothing can be learned
  std::vector<std::string> notes;               ///< what the reader of the recording said
  /// Without a vehicle file. The lessons then have no values: these scale with the mass.
  std::optional<RotorGuess> rotors;
};

/// Rates, gaps, jitter of every stream that has samples.
std::vector<StreamFigures> StreamsOf(const FlightLog& log);

/// Looks at a recording: streams, faults, phases, and which parameters it teaches. The pass of the
/// estimator that the last needs has keyframes at 25 Hz: enough for what is shown, in a fraction of
/// the time.
FlightInspection InspectFlight(FlightLog log, const Vehicle& vehicle);

/// The same without a vehicle file: what needs none, and which order and spins would fit. Phases
/// and what the flight teaches are those of the vehicle that FitVehicle() makes of the recording.
/// @throws std::invalid_argument where there is no frame of so many rotors
FlightInspection InspectFlightAlone(const FlightLog& log, int num_rotors);

/// The same in JSON, and in words for a terminal.
std::string InspectionReport(const FlightInspection& inspection);
std::string InspectionText(const FlightInspection& inspection);

}  // namespace odmc
