#pragma once

#include <optional>
#include <string>
#include <vector>

#include "odmc/inspection/vehicle_fit.h"
#include "odmc/io/vehicle_writer.h"
#include "odmc/model/frame_layout.h"

namespace odmc {

/// What a user knows of a vehicle; all but the mass may be left open.
struct KnownVehicle {
  std::string name = "my_vehicle";
  double mass_kg = 0.0;  ///< > 0
  std::string frame = "quad_x";
  Autopilot autopilot = Autopilot::kPx4;
  bool autopilot_asked = false;           ///< else it is a guess
  std::optional<double> arm_m;            ///< mean distance of the hubs from the origin
  std::optional<Eigen::Vector2d> half_m;  ///< largest |x| and |y| of a hub, in its place
  std::optional<double> radius_m;         ///< of the propellers
  std::optional<Eigen::Vector3d> inertia_kg_m2;
  std::vector<int> places;         ///< per reading: the frame's motor number, from 1; or empty
  std::vector<double> spins;       ///< per reading, as Rotor::spin; or empty
  std::optional<Vehicle> drawing;  ///< geometry and inertia in the frame's place (a URDF)
};

/// The vehicle as it is known before a flight: rotors in the order of the motor numbers, guesses
/// where nothing is known:
///
///   arm = 0.13 m (m/kg)^(1/3),  radius = 0.8 times half the least distance of two hubs,
///   I_x = I_y = 0.22 m arm²,  I_z = 0.85 (I_x + I_y).
///
/// Seven vehicles of 35 g to 0.95 kg lie within 20 % of the first, 15 % of the second, 0.17 to 0.33
/// (for 0.22) and 0.59 to 0.93 (for 0.85).
/// @throws std::invalid_argument where the frame is unknown or lists have another length
Vehicle VehicleBeforeFlight(const KnownVehicle& known);

/// A vehicle file with its comments: every entry says whether it was found (with its evidence),
/// guessed (by which formula) or asked for.
struct NewVehicle {
  Vehicle vehicle;
  VehicleComments comments;
  std::vector<int> order;           ///< per reading: the motor whose it is, from 0
  std::vector<std::string> report;  ///< for a terminal, an entry each
  std::vector<std::string> advice;  ///< what the flight does not tell, and what to fly
};

/// @param fit of a flight to VehicleBeforeFlight(known); null: no flight
/// @param flight its file's name
NewVehicle MakeVehicle(const KnownVehicle& known, const VehicleFit* fit, const std::string& flight);

}  // namespace odmc
