#pragma once

#include <Eigen/Core>
#include <string>
#include <string_view>
#include <vector>

#include "odmc/io/flight_read_options.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// \file
/// Data sets in the form in which they are published. What a format leaves open (order and
/// direction of the quaternion, frame of the velocity, turn of the IMU) is checked on the whole
/// flight; where the data say other than documented, they are followed and a warning says so.
/// @throws std::invalid_argument naming file, line and column; where nothing fits the data, with
/// the
///   residuals of all readings

/// NeuroBEM's CSV (UZH RPG, 2021): t; pos x..z (world z up); quat x..z, w of the body (FLU); vel
/// x..z, documented as along the body; ang vel x..z; mot 1..4 [rad/s]; vbat; acc x..z, which the
/// data set does not say to be measured: FlightReadOptions::accelerometer. Columns are found by
/// name; others are ignored.
FlightLog ReadNeurobem(const std::string& file, const FlightReadOptions& options);
bool IsNeurobem(std::string_view head);

/// One flight of MIT's Blackbird data set in its own terms.
struct BlackbirdFlight {
  std::string path;  ///< for sentences
  /// A pose in the axes of the source.
  struct Pose {
    Stamp stamp = 0;
    Eigen::Vector3d p_NED;
    Eigen::Vector4d named_q;  ///< what the source names w, x, y, z
  };
  /// Speeds of all rotors, one message.
  struct RotorMessage {
    std::vector<Stamp> stamps;  ///< of each rotor
    std::vector<double> rpm;
  };
  std::vector<Pose> poses;
  std::vector<ImuSample> imu;  ///< in the IMU's axes
  std::vector<RotorMessage> rotors;
  /// What the ESCs were told, by rotor.
  struct Command {
    Stamp stamp = 0;
    std::vector<double> pwm_us;
  };
  std::vector<Command> commands;
};

/// The flight in our frames: poses from NED and FRD to east, north, up and FLU; the IMU, documented
/// as yawed by 90 deg about the body's z, to the body; rotors, each with a stamp of its own,
/// linearly to the mean of a message's stamps. There is no velocity. Assumed and checked: the gyro
/// against the turns of the pose for four yaws and six orders of the quaternion, gravity by the
/// accelerometer.
/// @param log  has the warnings of reading; receives the streams
void ConvertBlackbird(BlackbirdFlight flight, const FlightReadOptions& options, FlightLog* log);

/// Blackbird's CSV exports, in the folder or its subfolder csv: blackbird_slash_state.csv,
/// .._rotor_rpm,
/// .._imu, .._pwm; poses from groundTruthPoses.csv where there is no state file. IMU and PWM may be
/// missing. The data set's own bags are read by odmc/ros/flight_bag.h.
FlightLog ReadBlackbird(const std::string& folder, const FlightReadOptions& options);
bool IsBlackbirdFolder(const std::string& folder);

}  // namespace odmc
