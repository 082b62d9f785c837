#pragma once

#include <CLI/CLI.hpp>
#include <optional>
#include <string>
#include <vector>

#include "odmc/inspection/stream_inspection.h"
#include "odmc/model/vehicle.h"
#include "odmc/ros/flight_bag.h"

namespace odmc::tools {

/// FLIGHT and how to read it.
struct FlightArguments {
  std::string file;
  std::vector<std::string> several;  ///< where AddSeveralTo() was called
  double start_s = 0.0, end_s = 0.0;
  PoseSource pose = PoseSource::kEkf;
  std::vector<std::string> topics;
  BagOptions bag;
  std::optional<int> pole_pairs;
  std::string odometry;  ///< recording with the poses, or folder of such; empty: FLIGHT has them
  std::optional<double> odometry_offset_s;
  bool accelerometer = false;
  double rotor_spread_s = FlightReadOptions().rotor_spread_s;
  std::string actuator_file;
  bool from_commands = false;

  /// Adds FLIGHT, --start, --end, --pose, --odometry, --topic, --twist-frame, --rotor-speed-unit,
  /// --pole-pairs, fields, units and orders of a bag's messages, --rotor-speed-from, --actuator.
  /// @param required false where the tool can do without a flight
  void AddTo(CLI::App* app, bool required = true);
  /// Adds FLIGHT and what says how a file is to be read: without --rotor-speed-from, --actuator.
  void AddReadingTo(CLI::App* app);
  /// The same as AddTo() with an option in the place of FLIGHT, which may be left out.
  void AddOptionTo(CLI::App* app, const std::string& option);
  /// The same as AddTo() with FLIGHT..., files, folders and patterns.
  void AddSeveralTo(CLI::App* app);
  /// The flights these name, each once: of a folder every flight in it and below, in natural order
  /// (flight2 before flight10).
  /// @throws std::invalid_argument naming what is no flight, or holds none
  std::vector<std::string> Expand() const;
  /// The flight with the rotor speeds to be used: rotors whose sensor is bad get the actuator
  /// model's, where there are commands.
  /// @throws std::invalid_argument, UsageError
  FlightLog Read(const Vehicle& vehicle) const { return Read(file, vehicle); }
  FlightLog Read(const std::string& flight, const Vehicle& vehicle) const;
  /// The ending of the flight's format, ".csv" or ".bfl"; empty where no format fits.
  std::string FormatEnding() const;
  /// The flight as it was recorded, whole.
  /// @throws std::invalid_argument, UsageError
  FlightLog ReadAsRecorded(const std::string& flight, int num_rotors,
                           FlightPart part = FlightPart::kWhole) const;

 private:
  void AddOptionsTo(CLI::App* app);
  void AddOdometryTo(CLI::App* app);
  /// Refuses options that do not belong to the format of the flight, nor to that of its poses.
  void CheckOptions(const FlightReaders& readers, const std::string& flight,
                    const std::string& poses) const;
  /// The recording of the flight's poses; empty where the flight has its own.
  std::string OdometryOf(const std::string& flight, const FlightReaders& readers) const;
  void AddFieldsTo(CLI::App* app);
  void AddActuatorTo(CLI::App* app);
};

/// Compares the recording's streams with each other and mends the log by what was found.
/// @param force goes on where nothing sensible can be learned
/// @throws std::invalid_argument naming the file, the cause and what would mend it
StreamInspection InspectFlight(const Vehicle& vehicle, bool force, FlightLog* log);

/// Adds --rotor-order and --command-order.
void AddOrders(CLI::App* app, StreamOptions* options);

/// Adds --own.
void AddOwn(CLI::App* app, std::vector<std::string>* own);

/// Adds --force.
void AddForce(CLI::App* app, bool* force);

}  // namespace odmc::tools
